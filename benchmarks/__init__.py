"""Figures of the project: python -m benchmarks [--only TOPIC] [--json FILE]."""
