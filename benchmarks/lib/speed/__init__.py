"""Nine closed loops are measured: times, sizes, instructions, counts, and the cost of the choices between forms."""
