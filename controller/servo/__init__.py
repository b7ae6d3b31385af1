"""Settings of the compiled servo, its interface per tick, and the rules of its faults."""
