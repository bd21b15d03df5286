//! Cost, gradient and Gauss-Newton matrix of the linear structure, one pass over the samples.
