"""Benchmarks: this library against what a user would take instead, ratios measured in one run."""
