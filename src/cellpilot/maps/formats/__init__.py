"""Files that hold a RadioMap; one file here for each format, one line for each in `maps/files.py`."""
