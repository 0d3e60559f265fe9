"""Section 3.2 of the paper: point samples become the picture that a lens forms."""
