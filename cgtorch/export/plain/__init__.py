"""What goes into an exported state machine as it stands: plain Python, and nothing else."""
