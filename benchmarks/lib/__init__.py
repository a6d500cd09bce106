"""Parts of the benchmarks: every module has measure(report)."""
