"""The languages between the stages of the compiler: kernels, sweeps, stage products, C nouns."""
