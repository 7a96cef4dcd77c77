"""Hostile input: files that are damaged on purpose, and what the library's loaders make of them."""
