"""The text of a translation unit: its own names, and what it does not need."""
