"""`shipfp view`: a local page to view raw logs, write TRIAL.toml, run it and read reports."""
