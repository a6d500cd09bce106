"""The user's names appear in C as constants of the header and as constants in kernels."""
