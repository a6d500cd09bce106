"""Parts of the benchmarks: each has measure(report)."""
