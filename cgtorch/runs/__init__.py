"""A run on disk: its folder, settings, journal and ledger, and how one goes on with it."""
