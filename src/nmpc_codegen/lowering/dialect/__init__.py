"""The C of the parts: its tree, its expressions, its names, what is known of them."""
