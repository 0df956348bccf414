"""Learners: they know the map only through what was measured in flight."""
