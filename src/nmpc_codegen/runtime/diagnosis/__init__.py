"""A diagnosis explains why a call was not OK: what is not finite, what is violated, and what to try."""
