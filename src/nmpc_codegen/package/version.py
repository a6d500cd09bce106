"""The version of the generator is stated in its packages."""

__version__ = "0.1.0"
