"""Ship fingerprinting: the dynamic parameters of a propulsion drive train from a raw trial log."""

from shipfp_rs._core import __version__

__all__ = ["__version__"]
