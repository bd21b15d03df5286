"""General helpers of all subpackages, independent of ships: files, tables, hints, threads."""
