"""The exceptions of the package: one line each that says what was found, what was expected, what to do."""


class ShipfpError(Exception):
    """Base of every error that this package raises on purpose."""


class InputError(ShipfpError, ValueError):
    """A file, key, channel, unit or value that the user gave can't be used."""


class SimulationError(ShipfpError):
    """A simulation left the range of finite numbers."""


class IdentificationError(ShipfpError):
    """The optimisation could not produce an estimate."""


class InternalError(ShipfpError):
    """A defect of this library, caught before it could end the process."""


class LogWarning(UserWarning):
    """Something of a log was left out or lost; the rest was read."""
