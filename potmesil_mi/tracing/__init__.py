"""Section 3.1 of the paper: rays through a pinhole become point samples."""
