"""`shipfp view`: a local page to look through raw logs, to write TRIAL.toml, to run it and to read reports."""
