"""Searches for skills of an arm that have the same primitives, percepts and low-level steps."""
