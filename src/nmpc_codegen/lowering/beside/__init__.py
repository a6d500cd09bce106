"""These files go beside those of a package: the loop with an estimator, a ring of dumps; and the folder for all."""
