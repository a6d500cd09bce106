"""Algebraic equations: their statement, what expressions solve of them, and what is left to Newton's method."""
