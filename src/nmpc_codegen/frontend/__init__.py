"""Front end: check what the user states, classify it, freeze it into a Problem, and add what follows from it."""
