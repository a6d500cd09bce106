"""Implicit Runge-Kutta schemes: the component, its kernels, the functions of an interval and their operations."""
