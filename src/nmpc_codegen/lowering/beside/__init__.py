"""Files beside a package are made here: the loop with an estimator, a ring of dumps; and the folder of all files."""
