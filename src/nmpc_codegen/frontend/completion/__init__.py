"""A Problem is completed by everything that follows from it before any component is chosen."""
