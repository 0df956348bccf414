"""Where maps come from, one file per kind."""
