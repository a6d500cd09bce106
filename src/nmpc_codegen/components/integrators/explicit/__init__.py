"""Explicit Runge-Kutta schemes are sweeps over steps and stages, printed as straight-line code or as loops."""
