"""Standard tasks of the field, the same for this library and for its peers."""
