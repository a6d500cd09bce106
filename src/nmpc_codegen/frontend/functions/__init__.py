"""Functions that expressions of a problem may contain, besides those of CasADi."""
