"""Experiments: calibrated signals with units and an operating point, and their file."""
