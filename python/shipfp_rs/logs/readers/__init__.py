"""Readers of logger formats, one module a format; `Log.open` loads the one that it needs."""
