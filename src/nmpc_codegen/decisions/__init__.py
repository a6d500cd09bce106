"""Choices that options leave open are made here from trials and counts, each with its reason."""
