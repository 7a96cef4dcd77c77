"""A run on disk: its folder, settings, journal and ledger, and how it is resumed."""
