"""Parts of benchmarks.adjoint: derivatives of single-shooting problems, and the controller that uses them."""
