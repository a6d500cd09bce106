"""Problem -> CompleteProblem: what follows from a problem before anything is chosen for it."""
