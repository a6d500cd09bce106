"""A package has sizes, tables, members and entry points besides those of components; each file has one owner."""
