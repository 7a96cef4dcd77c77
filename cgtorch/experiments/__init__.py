"""Runs: the experiments of section VI, their files and their tests in the world."""
