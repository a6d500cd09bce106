"""Estimators run in Python, alone or in a closed loop."""
