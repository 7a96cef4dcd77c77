"""The lines of tools/benchmark.py: one function per ratio, grouped by what they measure."""
