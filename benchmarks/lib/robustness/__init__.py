"""What the benchmark of robustness is made of."""
