"""Runs: from a trial file to a folder of results."""
