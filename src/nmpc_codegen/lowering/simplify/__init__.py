"""Code of a function that a package does not need is removed by edits of its text."""
