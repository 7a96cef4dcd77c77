"""Peers of `compare_locomotion.py`, and the episodes of linear policies that they play."""
