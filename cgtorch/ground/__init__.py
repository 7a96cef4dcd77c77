"""Foundations: interfaces of worlds and models, errors, files, numbers, processes."""
