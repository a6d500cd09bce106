"""Flights in parts, by workers, kept on disk as they come."""
