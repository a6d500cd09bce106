"""Draws contain closed loops that one full step per sample does not bring nearer to a solution."""
