"""The figures and tables of the five papers that the compiler implements are computed and drawn again."""
