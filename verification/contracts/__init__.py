"""A contract is a promise of every package, whatever its components are; samples are held to contracts.

A contract is a function of a Subject, a sample with its package. It is registered once and applies to every sample
whose components it allows. ``python -m verification --table`` prints contracts by components.
"""
