"""A batch keeps many controllers in one block of memory, calls them on all cores and simulates closed loops in C."""
