"""Estimators run in Python, separately or in a closed loop."""
