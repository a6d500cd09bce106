"""The intermediate representations of the compiler: kernels, sweeps, stage products, C modules."""
