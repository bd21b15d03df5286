"""Vessels: drive trains of ships, their steady state and linear parameters."""
