"""Simulated experiments and simulated raw logs of a vessel."""
