"""Strangers are problems for which no default was made; the product and an independent twin solve each."""
