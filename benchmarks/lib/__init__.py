"""Every module of the benchmarks has measure(report)."""
