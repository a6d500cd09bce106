"""Options and weights that are chosen by campaigns."""
