"""Algebraic equations are stated, solved by expressions as far as possible, and left to Newton's method otherwise."""
