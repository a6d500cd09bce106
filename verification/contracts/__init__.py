"""Contracts: what every package promises, whatever its components are, and the samples that are held to them.

A contract is a function of a Subject, a sample with its package. It is registered once, and every sample whose
components it allows is under it. ``python -m verification --table`` prints contracts by components.
"""
