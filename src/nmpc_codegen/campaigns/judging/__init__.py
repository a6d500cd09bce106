"""Verdicts on flights, what a campaign has found, and loops with converged plans to compare it with."""
