"""The scheme of an integrator: whether it is stable, which one is chosen, and why."""
