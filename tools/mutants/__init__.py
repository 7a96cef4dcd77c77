"""Mutation testing: small changes of the package, and the tests that are to notice them."""
