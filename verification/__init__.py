"""Tests and benchmarks share this package, which imports neither of them."""
