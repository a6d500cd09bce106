"""The version of the generator, which its packages state."""

__version__ = "0.1.0"
