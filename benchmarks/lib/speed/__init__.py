"""Parts of benchmarks.speed."""
