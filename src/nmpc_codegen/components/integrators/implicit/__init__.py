"""Implicit Runge-Kutta schemes consist of a component, its kernels, the functions of an interval and their counts."""
