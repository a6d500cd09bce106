"""Faults that are put into the C core and the compiler, one at a time, and the tests that have to see them."""
