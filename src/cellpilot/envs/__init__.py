"""The compiled environment: one step, one flight and many."""
