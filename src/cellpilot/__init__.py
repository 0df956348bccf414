"""cellpilot."""
