"""Processing of a log with a trial file into experiments."""
