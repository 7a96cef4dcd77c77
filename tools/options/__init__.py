"""Options that tools have in common."""
