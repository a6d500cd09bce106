"""Estimators in Python, and their loops."""
