"""JSON without NaN and infinity, which JSON does not have: they are written as null, and refused when read."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.support.files import read_text

HALF = re.compile(r"\\u[dD][89a-fA-F]")
"""Escape of half a character, which no file can hold in UTF-8."""


def finite(content: Any) -> Any:
    """Return content with None in place of numbers that are not finite, and Python's own numbers in place of NumPy's."""
    if isinstance(content, np.generic | np.ndarray) and content.ndim == 0:
        content = content.item()
    if isinstance(content, float):
        return content if math.isfinite(content) else None
    if isinstance(content, Mapping):
        return {key: finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [finite(value) for value in content]
    return content


def json_text(content: Any, *, ascii_only: bool = True) -> str:
    """Return one JSON document, indented, with an end of line."""
    return json.dumps(finite(content), indent=2, ensure_ascii=ascii_only, allow_nan=False) + "\n"


def read_json(path: Path, expected: str) -> Any:
    """Read a JSON file.

    Parameters
    ----------
    path
        File to read, UTF-8.
    expected
        What it should be, as a message calls it: "a fingerprint, as `shipfp run` writes it".

    Raises
    ------
    InputError
        Where it can't be read, is not JSON, or holds NaN, a number without end or half a character; one line.
    """
    return parsed_json(read_text(path, expected), str(path), expected)


def parsed_json(text: str | bytes, source: str, expected: str) -> Any:
    """Return what a JSON text holds; `source` opens the message of the `InputError` where it is none, as `read_json`."""

    def refused(word: str) -> NoReturn:
        raise InputError(f"{source}: found {word[:40]}, expected finite numbers; write the file anew")

    def number(text: str) -> float:
        value = float(text)
        return value if math.isfinite(value) else refused(text)

    try:
        text = text if isinstance(text, str) else text.decode()
        content = json.loads(text, parse_constant=refused, parse_float=number)
        if HALF.search(text):  # most are one of a pair, which makes a whole character
            json.dumps(content, ensure_ascii=False).encode()
    except RecursionError as error:
        raise InputError(f"{source}: nested too deeply, expected {expected}") from error
    except json.JSONDecodeError as error:
        raise InputError(f"{source}: not JSON ({error}), expected {expected}") from error
    except InputError:
        raise
    except UnicodeEncodeError as error:
        raise InputError(f"{source}: found half a character of UTF-16, expected {expected}") from error
    except ValueError as error:  # a whole number of more digits than Python takes
        raise InputError(f"{source}: {str(error).split(';')[0]}, expected {expected}") from error
    return content
