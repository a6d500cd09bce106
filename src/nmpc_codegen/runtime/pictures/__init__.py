"""Pictures: of closed loops, plans, rows, times and iterations, with matplotlib."""
