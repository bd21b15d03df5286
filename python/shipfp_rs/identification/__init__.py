"""Fits of structures to data: search, estimates, intervals, residual tests, fingerprint."""
