"""Upper bounds on the operations of a package, from the text of its C functions."""
