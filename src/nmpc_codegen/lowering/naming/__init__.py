"""The names of the user in C: constants of the header, and constants in kernels."""
