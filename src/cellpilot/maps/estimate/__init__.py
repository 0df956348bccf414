"""Ways to estimate cells that nobody measured, each a separate recorded step."""
