"""What everyone stands on: errors, files, numbers, random numbers, ranks and processes."""
