"""Routines are printed as C text: spelling, names of constants, expressions, straight-line kernels, loops, products."""
