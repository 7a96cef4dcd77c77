"""Worlds in which the same decisions lead to different returns, and rules that are hard to beat."""
