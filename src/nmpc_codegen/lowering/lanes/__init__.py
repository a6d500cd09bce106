"""Linearisation of several shooting nodes at once, one per lane of vectors."""
