"""Flights are divided into parts, which workers fly and whose results are written to disk."""
