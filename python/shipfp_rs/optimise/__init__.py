"""Bounded least squares: the search, its last steps, and whether its end is a minimum."""
