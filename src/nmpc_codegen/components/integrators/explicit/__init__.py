"""Explicit Runge-Kutta schemes: sweeps over steps and stages, which are printed as straight-line code or as loops."""
