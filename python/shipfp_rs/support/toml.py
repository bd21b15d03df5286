"""Configuration from TOML files, validated by a pydantic model; the first mistake is reported in one line."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence, Sized
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_args, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from shipfp_rs.errors import InputError
from shipfp_rs.support.arguments import LINES, is_one_line, shown
from shipfp_rs.support.files import read_text
from shipfp_rs.support.hints import Hinted, HintedType, nearest, suggestion
from shipfp_rs.support.validation import wrong

Model = TypeVar("Model", bound=BaseModel)

LARGEST, SMALLEST = 1e15, 1e-15
"""Range of the magnitude of numbers, wider than that of any quantity of a ship or a log; a seed may be larger."""
MOST_CHARACTERS = 2000
"""Longest text, such as a path or a description."""

TO_BE_GIVEN = "to be given"
"""Placeholder in a template for a value that the user must give; a file that still has it is rejected."""
SEVERAL_LINES = "description"
"""The only key whose text may contain line ends and tabs."""

_PYDANTIC = frozenset(dir(BaseModel))

Name = Annotated[str, Field(min_length=1, max_length=200)]
"""Type of the name of a trial, a window or a channel."""
FilePath = Annotated[str, Field(min_length=1)]
Seed = Annotated[int, Field(ge=0, le=2**63 - 1)]
Starts = Annotated[int, Field(ge=1, le=10_000)]
"""Type of the number of starts of a search; each start takes about a second."""


if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)


class _Named(HintedType, ModelMetaclass):
    """Metaclass that hides pydantic's names from completion."""

    def __dir__(cls) -> list[str]:
        return [name for name in super().__dir__() if name not in _PYDANTIC]


class Section(Hinted, BaseModel, metaclass=_Named):
    """Base of every table of a configuration file: immutable, no unknown keys, no conversion of types."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, str_max_length=MOST_CHARACTERS
    )

    def __dir__(self) -> list[str]:
        return [name for name in super().__dir__() if name.startswith("__") or name not in _PYDANTIC]


def unexpected(key: str, found: object, expected: str) -> PydanticCustomError:
    """Error to be raised by a validator of several keys; `key` is relative to the validator's section."""
    return wrong(expected, found, key)


def read_toml(path: str | Path, model: type[Model]) -> Model:
    """Read a TOML file into a pydantic model, usually derived from `Section`.

    `InputError` if the file can't be read, is not TOML, or has a key or value that the model rejects: one line,
    "file: key: found ..., expected ...".
    """
    return validated(read_tables(Path(path)), model, str(path))


def read_tables(path: Path) -> dict[str, Any]:
    """Tables of a TOML file; `InputError` if it can't be read or is not TOML."""
    return parsed_toml(read_text(path, "a TOML file"), str(path))


def parsed_toml(text: str, source: str) -> dict[str, Any]:
    """Tables of a text; `source` starts the message of the `InputError` if it is not TOML."""
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise InputError(f"{source}: nested too deeply, expected tables of keys and values") from error
    except ValueError as error:  # invalid TOML, or an integer with too many digits for Python
        raise InputError(f"{source}: not TOML: {str(error).split(';')[0]}") from error


def built_in(kind: str) -> dict[str, Path]:
    """Files of a kind ("vessels", "sweeps") included in the package, by name."""
    folder = Path(str(resources.files("shipfp_rs") / "data" / kind))
    return {path.stem: path for path in sorted(folder.glob("*.toml"), key=lambda path: path.stem)}


def template(name: str) -> str:
    """Text of the commented template of a configuration file, "TRIAL" or "SWEEP"."""
    return built_in("templates")[name].read_text(encoding="utf-8")


def read_named(name_or_path: str | Path, model: type[Model], kind: str, key: str, what: str) -> Model:
    """Read a built-in file by its name, or a user's file by its path; a built-in name takes precedence.

    `kind` selects the built-in files, see `built_in`; `key` ("vessel") and `what` ("ship") are for messages.
    `InputError` if neither exists; also see `read_toml`.
    """
    name, known = str(name_or_path), built_in(kind)
    if not name or not is_one_line(name):
        raise InputError(f"{key} {name[:60]!r}: expected a {what} by its name or by the path of its file")
    path = known.get(name, Path(name_or_path))
    try:
        there = path.exists()
    except OSError:  # a name too long for a file
        there = False
    if name not in known and path.suffix != ".toml" and not there:
        raise InputError(
            f"{key} {name!r}: found no built-in {what} of this name, {suggestion(name, [*known])} "
            f"(give your own {what} by the path of its .toml file)"
        )
    return read_toml(path, model)


def validated(content: Mapping[str, Any], model: type[Model], source: str) -> Model:
    """Validate parsed `content`; `source` starts the message of the `InputError`."""
    try:
        _require_plain(content, source)
        return model.model_validate(content)
    except RecursionError as error:
        raise InputError(f"{source}: nested too deeply, expected tables of keys and values") from error
    except ValidationError as error:
        raise InputError(f"{source}: {_first_mistake(error, model)}") from error


def _require_plain(content: Mapping[str, Any], source: str) -> None:
    """Reject texts of several lines, and numbers out of range."""
    for key, value in _leaves(content, ()):
        if isinstance(value, str):
            inside = value.translate(LINES) if key.endswith(SEVERAL_LINES) else value
            if not is_one_line(inside):
                raise InputError(
                    f"{source}: {key}: found {shown(value)}, expected a text without control characters"
                )
            continue
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(f"{source}: {key}: found {value}, expected a finite number")
        if abs(value) > LARGEST and not key.endswith("seed"):
            raise InputError(
                f"{source}: {key}: found {shown(value)}, expected a number of at most {LARGEST:g} in size"
            )
        if 0.0 < abs(value) < SMALLEST:
            raise InputError(
                f"{source}: {key}: found {value}, expected 0 or a number of at least {SMALLEST:g} in size"
            )


def _first_mistake(error: ValidationError, model: type[BaseModel]) -> str:
    first, *others = error.errors()
    if first["type"] == "missing":
        # An unknown key in the section of a missing key is probably the missing key, misspelt.
        unknown = [other for other in others if other["type"] == "extra_forbidden"]
        first = next((other for other in unknown if other["loc"][:-1] == first["loc"][:-1]), first)
    absent = [each["loc"] for each in error.errors() if each["type"] == "missing"]
    missing = [".".join(map(str, place)) for place in absent if isinstance(place[-1], str)]
    if first["type"] == "missing" and len(missing) > 1:
        return f"{', '.join(missing)}: found nothing, expected these keys to be given"
    return _one_line(first, model)


def _leaves(content: object, place: tuple[str, ...]) -> Iterator[tuple[str, float | str]]:
    """Yield every number and text in parsed content with its dotted key, and every key as a text."""
    if isinstance(content, Mapping):
        for key, value in content.items():
            yield ".".join((*place, "a key")), str(key)
            yield from _leaves(value, (*place, str(key)))
    elif isinstance(content, list | tuple):
        for index, value in enumerate(content):
            yield from _leaves(value, (*place, str(index)))
    elif isinstance(content, int | float | str):
        yield ".".join(place), content


def _one_line(error: ErrorDetails, model: type[BaseModel]) -> str:
    # For a union of types, pydantic appends the type to the location; the message keeps only the key.
    location = [str(part) for part in error["loc"] if str(part) not in ("float", "int", "bool", "str")]
    key, found, context = ".".join(location), error["input"], error.get("ctx", {})
    match error["type"]:
        case "wrong":
            key = ".".join([*location, context["key"]])
            return f"{key}: found {context['found']}, expected {context['expected']}{_near_table(model, location)}"
        case "extra_forbidden":
            known = sorted(
                {key for owner in _models_at(model, error["loc"][:-1]) for key in owner.model_fields}
            )
            if near := _near_table(model, location[:-1]):
                return f"{'.'.join(location[:-1])}: found a table with an unknown key, {location[-1]!r}{near}"
            return f"{key}: found an unknown key, {suggestion(location[-1], known)}"
        case "missing" if isinstance(error["loc"][-1], int):
            key = ".".join(location[:-1])
            return f"{key}: found {shown(found)}, expected a list of more than {error['loc'][-1]}"
        case "missing":
            return f"{key}: found nothing, expected this key to be given"
        case "too_short" | "too_long" | "string_too_short" | "string_too_long":
            return f"{key}: found {_length(found)}, expected {_lengths(error['type'], context)}"
    if location != [str(part) for part in error["loc"]]:
        return f"{key}: found {shown(found)}, expected a number, a text in quotes, true or false"
    return f"{key}: found {shown(found)}, expected {_expected(error)}"


def _near_table(model: type[BaseModel], location: Sequence[str]) -> str:
    """Text with the known table most similar to an unknown table; empty if none is similar."""
    beside = [name for owner in _models_at(model, location[:-1]) for name in owner.model_fields]
    return nearest(location[-1], beside, 0.7) if location and location[-1] not in beside else ""


def _expected(error: ErrorDetails) -> str:
    """Expected value, described with TOML's terms."""
    match error["type"]:
        case "model_type" | "dict_type" | "model_attributes_type":
            return "a table"
        case "float_type" | "int_type" if isinstance(error["input"], str):
            return "a valid number, without quotes"
        case "tuple_type" | "list_type":
            return "a list"
        case "string_type":
            return "a text in quotes"
        case "bool_type":
            return "true or false"
        case _:
            return error["msg"].removeprefix("Value error, ").removeprefix("Input should be ")


def _length(found: object) -> str:
    if isinstance(found, str):
        return f"{len(found)} characters" if found else "an empty text"
    size = len(found) if isinstance(found, Sized) else 0
    return f"{size} value{'' if size == 1 else 's'}"


def _lengths(kind: str, context: Mapping[str, Any]) -> str:
    limit = context.get("min_length", context.get("max_length"))
    which = "at least" if kind.endswith("short") else "at most"
    if kind.startswith("string"):
        return (
            "a text that is not empty" if (which, limit) == ("at least", 1) else f"{which} {limit} characters"
        )
    return f"a list of {which} {limit}"


def _models_at(model: type[BaseModel], location: Sequence[int | str]) -> set[type[BaseModel]]:
    """Models that may apply at `location`; list indices and tags of unions in it are skipped."""
    found = {model}
    for part in location:
        inner = {nested for owner in found for nested in _models_in(_annotation(owner, str(part)))}
        found = inner or found
    return found


def _annotation(owner: type[BaseModel], key: str) -> Any:
    """Type of a key, or of extra tables if the model accepts them."""
    field = owner.model_fields.get(key)
    return field.annotation if field else get_type_hints(owner).get("__pydantic_extra__")


def _models_in(annotation: Any) -> set[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return {annotation}
    return {nested for argument in get_args(annotation) for nested in _models_in(argument)}
