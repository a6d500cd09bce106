"""What a package does not need of a function, as edits of its text."""
