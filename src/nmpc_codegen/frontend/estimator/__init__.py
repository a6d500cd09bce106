"""Estimators: their statement, and the problem that they solve."""
