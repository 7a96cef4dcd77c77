"""Robot arms in other people's simulators: primitives, worlds, and the tasks of two benchmarks."""
