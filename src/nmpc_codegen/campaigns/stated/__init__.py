"""What is flown: distributions, defaults, data of every flight."""
