"""The compiler has intermediate representations: kernels, sweeps, stage products, C modules."""
