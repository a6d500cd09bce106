"""Measurements of the augmented Lagrangian."""
