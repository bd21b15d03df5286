"""Raw logs: channels read in blocks, file formats, and faults."""
