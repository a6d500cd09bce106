"""The figures and tables of the five papers that the compiler implements, computed and drawn anew."""
