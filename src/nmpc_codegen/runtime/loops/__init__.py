"""A closed loop connects a controller with a plant and sets its data at every sample."""
