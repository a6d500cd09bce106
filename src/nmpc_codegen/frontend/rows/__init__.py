"""Rows of a problem: how they are stated."""
