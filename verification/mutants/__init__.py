"""Faults are put into the C core and the compiler, one at a time, and tests have to detect them."""
