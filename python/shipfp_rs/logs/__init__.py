"""Raw logs: channels read piece by piece, file formats, and what is wrong with a log."""
