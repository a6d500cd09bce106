"""The C of the parts is parsed: its tree, its expressions, its names, and known values."""
