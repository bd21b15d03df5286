"""Exceptions of the package; each message is one line that says what was found, what was expected and what to do."""

LONGEST_WORD = 300
"""Longest name that a message shows completely, in characters."""

LONGEST_LINE = 1500


class ShipfpError(Exception):
    """Base class of all errors that this package raises on purpose; the message is a single line."""

    def __init__(self, *arguments: object) -> None:
        super().__init__(*(_line(one) if isinstance(one, str) else one for one in arguments))


def _line(text: str) -> str:
    words = " ".join(text.splitlines()).split(" ")
    line = " ".join(word if len(word) <= LONGEST_WORD else f"{word[:60]}...{word[-20:]}" for word in words)
    return line if len(line) <= LONGEST_LINE else f"{line[: LONGEST_LINE - 200]} ... {line[-190:]}"


class InputError(ShipfpError, ValueError):
    """A file, key, channel, unit or value that the user gave can't be used."""


class UnknownNameError(InputError, KeyError):
    """An object indexed by name has no such entry; also a `KeyError`, as for any mapping."""

    __str__ = Exception.__str__


class SimulationError(ShipfpError):
    """A simulation overflowed."""


class IdentificationError(ShipfpError):
    """The optimisation could not produce an estimate."""


class InternalError(ShipfpError):
    """A defect of this library, caught before it ends the process."""


class LogWarning(UserWarning):
    """A part of a log was skipped or lost; the rest was read."""
