"""General helpers, independent of ships, used by all subpackages: files, tables, hints, threads."""
