"""The benchmarks measure the project's figures: python -m benchmarks [--only TOPIC] [--json FILE]."""
