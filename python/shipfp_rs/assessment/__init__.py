"""Assessment of fingerprints: prediction, validation, comparison, profiles."""
