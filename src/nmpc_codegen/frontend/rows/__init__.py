"""The rows of a problem are stated here."""
