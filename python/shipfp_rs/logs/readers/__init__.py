"""Readers of logger formats, one module per format, imported by `Log.open` on demand."""
