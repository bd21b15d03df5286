"""What every room leans on and that knows nothing of ships: files, tables, hints, threads."""
