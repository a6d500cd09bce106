"""Parts of the benchmark of the code base."""
