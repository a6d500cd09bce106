"""Verdicts, replays, reference loops, pictures."""
