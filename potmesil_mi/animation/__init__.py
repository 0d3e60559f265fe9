"""Animations: pictures of the same samples through a lens that changes from frame to frame."""
