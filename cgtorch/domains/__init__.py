"""Domains: the task of a run, and Γ and C learned for any domain.

Your own domain is a subclass of `Domain` with a `World` and scenarios (`ScenarioBatch`); see
docs/own-domain.md. Settings and names are needed by commands that do not wait for torch, so nothing
is imported here.
"""
