"""Settings of the compiled servo, its interface per tick, and its constants."""
