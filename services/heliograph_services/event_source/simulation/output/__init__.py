"""What a simulation leaves: files, truth, pictures."""
