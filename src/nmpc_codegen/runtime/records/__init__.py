"""Closed loops and solve() leave records: logs, recordings, replays of dumps, with their tables and files."""
