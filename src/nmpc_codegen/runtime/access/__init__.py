"""The structs of a package are read and written here, by NumPy views and by the names of the problem."""
