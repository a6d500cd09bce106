"""Figures of the project: python -m benchmarks.<topic> [--json FILE]."""
