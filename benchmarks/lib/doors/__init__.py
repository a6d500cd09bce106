"""What the benchmark of doors is made of."""
