"""Simulated trials of four kinds of drive train, made without any code of the package, and the score of what it answers."""
