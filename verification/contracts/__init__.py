"""A contract is a property that every generated package must have; sample packages are tested for it.

Each contract is a function of a Subject, a sample with its compiled package. It is registered once, and run for every
sample whose components it supports. ``python -m verification --table`` prints contracts by components.
"""
