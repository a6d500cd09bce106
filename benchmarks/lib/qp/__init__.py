"""QPs of closed loops and random QPs, and their solvers."""
