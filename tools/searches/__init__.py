"""The parts of `tools/compare_search.py`."""
