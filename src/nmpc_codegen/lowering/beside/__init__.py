"""Files beside those of a package: the loop with an estimator, a ring of dumps."""
