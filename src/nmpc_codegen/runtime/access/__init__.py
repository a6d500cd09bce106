"""Views on the structs of a package, and the data that names mean."""
