"""Tracking problems against IPOPT and against the figures of their paper."""
