"""Parts of the benchmarks: modules with measure(report)."""
