"""The coach chooses options and weights by campaigns."""
