"""What all other folders use: errors, files, numerics, random numbers, ranks and processes."""
