"""Vessels: what a ship's drive train is, its steady state and its linear parameters."""
