"""Closed loops of a controller and a plant, and what they are told at every sample."""
