"""What `tools/compare_methods.py` makes of its results."""
