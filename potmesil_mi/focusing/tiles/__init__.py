"""Tiles: a picture that is formed part by part, and is the one that is formed as a whole.

What of it is chosen from all of its samples is found out tile by tile first, see
:mod:`potmesil_mi.focusing.choices`.
"""
