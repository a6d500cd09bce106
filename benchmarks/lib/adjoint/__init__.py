"""Parts of benchmarks.adjoint: derivatives of single-shooting problems."""
