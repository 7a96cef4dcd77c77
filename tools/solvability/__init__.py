"""Which scenes of the table can be solved at all, whoever drives."""
