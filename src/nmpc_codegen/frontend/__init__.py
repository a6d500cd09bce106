"""Front end: check what the user states, classify it and freeze it into a Problem."""
