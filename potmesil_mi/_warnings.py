"""Warnings that have a category of their own, by which a program can silence them."""

from __future__ import annotations


class FocusWarning(UserWarning):
    """A picture will be formed that is probably not meant, such as one in which nothing is blurred.

    It is given once for the same samples. A program that means it silences it by
    ``warnings.simplefilter("ignore", potmesil_mi.FocusWarning)``.
    """
