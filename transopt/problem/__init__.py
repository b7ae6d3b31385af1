"""The optimal-control problem of one library entry: its terms, its limits, and what an answer to it is."""
