"""What a fingerprint is worth: prediction, validation, comparison, profiles."""
