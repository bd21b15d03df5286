"""Faults of raw logs: what each looks like, where it is, what was done about it (thesis, section 6.3)."""

# `scan` needs SciPy: readers, whose processes start with every log, load the record only.
from shipfp_rs.logs.faults.record import KINDS, Fault

__all__ = ["KINDS", "Fault"]
