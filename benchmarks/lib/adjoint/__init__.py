"""Parts of the topic adjoint: derivatives of single-shooting problems, and the controller that uses them."""
