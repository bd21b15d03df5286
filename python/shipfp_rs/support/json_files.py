"""JSON files without NaN and infinity: written as null, rejected when read."""

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
"""Escape of a surrogate, which UTF-8 files can't hold."""


def finite(content: Any) -> Any:
    """Replace non-finite numbers by None and NumPy numbers by Python ones."""
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
    """Indented JSON document with a line end."""
    return json.dumps(finite(content), indent=2, ensure_ascii=ascii_only, allow_nan=False) + "\n"


def read_json(path: Path, expected: str) -> Any:
    """Read a UTF-8 JSON file; `InputError`, with the `expected` content, if it is invalid or contains NaN."""
    return parsed_json(read_text(path, expected), str(path), expected)


def parsed_json(text: str | bytes, source: str, expected: str) -> Any:
    """Parse a JSON text; `source` starts the message of the `InputError`, see `read_json`."""

    def refused(word: str) -> NoReturn:
        raise InputError(f"{source}: found {word[:40]}, expected finite numbers; write the file anew")

    def number(text: str) -> float:
        value = float(text)
        return value if math.isfinite(value) else refused(text)

    try:
        text = text if isinstance(text, str) else text.decode()
        content = json.loads(text, parse_constant=refused, parse_float=number)
        if HALF.search(text):  # most belong to a pair, a whole character
            json.dumps(content, ensure_ascii=False).encode()
    except RecursionError as error:
        raise InputError(f"{source}: nested too deeply, expected {expected}") from error
    except json.JSONDecodeError as error:
        raise InputError(f"{source}: not JSON ({error}), expected {expected}") from error
    except InputError:
        raise
    except UnicodeEncodeError as error:
        raise InputError(f"{source}: found half a character of UTF-16, expected {expected}") from error
    except ValueError as error:  # an integer with too many digits for Python
        raise InputError(f"{source}: {str(error).split(';')[0]}, expected {expected}") from error
    return content
