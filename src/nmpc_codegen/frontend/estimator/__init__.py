"""Estimators are stated here and turned into the problem that they solve."""
