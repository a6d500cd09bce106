"""Times, sizes, instructions and counts of nine closed loops; what the choices between forms cost."""
