"""QPs of closed loops and random ones, and who solves them."""
