"""What the benchmark of the house is made of."""
