"""From a log and a trial file to clean experiments."""
