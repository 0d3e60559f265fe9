"""Point samples: what the two stages share, and how they are kept in files."""
