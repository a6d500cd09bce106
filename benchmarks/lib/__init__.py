"""Parts of benchmarks: each module has measure(report)."""
