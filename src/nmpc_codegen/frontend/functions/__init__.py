"""Expressions of a problem may contain these functions besides those of CasADi."""
