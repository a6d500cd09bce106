"""The benchmark of robustness has these parts."""
