"""Faults of raw logs: kinds, detection, and the record of their treatment (thesis, section 6.3)."""

# `scan` imports SciPy. The readers run in child processes that must start fast, so they import only `record`.
from shipfp_rs.logs.faults.record import KINDS, Fault

__all__ = ["KINDS", "Fault"]
