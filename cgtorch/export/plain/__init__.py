"""The parts of exported state machines, copied as they are: plain Python, nothing else."""
