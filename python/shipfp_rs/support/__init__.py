"""Helpers shared by all packages and independent of ships: files, tables, hints, threads."""
