"""The base of all packages: errors, files, numerics, random numbers, ranks and processes."""
