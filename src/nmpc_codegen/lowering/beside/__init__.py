"""Files beside those of a package, the loop with an estimator, a ring of dumps; and the folder that all go to."""
