"""Faults of raw logs: kinds, detection, and the record of their treatment (thesis, section 6.3)."""

# `scan` needs SciPy; readers, whose processes start with every log, import only the record.
from shipfp_rs.logs.faults.record import KINDS, Fault

__all__ = ["KINDS", "Fault"]
