"""A run on disk: its folder, settings, log and journal, and how it is resumed."""
