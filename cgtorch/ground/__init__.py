"""What all stands on: interfaces of worlds and models, errors, files, numbers, processes."""
