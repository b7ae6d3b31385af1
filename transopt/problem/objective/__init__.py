"""The terms of the objective, each in its own file, and the figures by which a movement is judged."""
