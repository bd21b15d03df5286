"""Virtual experiments and raw logs from a vessel."""
