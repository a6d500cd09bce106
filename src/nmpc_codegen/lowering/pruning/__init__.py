"""Parts as trees, and what a package does not need left out: tree.py reads, passes.py edits, unit.py reaches."""
