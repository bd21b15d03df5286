"""NumPy references of the kernels: plain, slow, obviously right."""
