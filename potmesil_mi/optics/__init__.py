"""Section 2 of the paper: camera, lens, apertures and how they spread light. No Mitsuba."""
