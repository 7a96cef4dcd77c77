"""Work shared out among the ranks of a process group, and among processes of one machine."""
