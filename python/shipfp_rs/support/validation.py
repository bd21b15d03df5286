"""Dataclasses whose fields pydantic checks against their annotations; the first mistake is reported in one line."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, Field, PlainValidator, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as pydantic_dataclass
from pydantic_core import ErrorDetails, PydanticCustomError

from shipfp_rs.errors import InputError
from shipfp_rs.support.arguments import is_one_line, shown

Made = TypeVar("Made")

WORDS: Mapping[str, str] = {
    **dict.fromkeys(("float_type", "int_type"), "a number"),
    **dict.fromkeys(("dict_type", "mapping_type"), "a table"),
    **dict.fromkeys(("list_type", "tuple_type"), "a list"),
    "bool_type": "true or false",
    "missing": "a value",
    "greater_than_equal": "{ge:g} or more",
    "less_than_equal": "{le:g} or less",
    "greater_than": "more than {gt:g}",
}
"""Expectation with limits, by type of pydantic's error; the messages of all other errors state the expectation."""


def wrong(expected: str, found: object = None, key: str = "") -> PydanticCustomError:
    """Error to be raised by a validator; `key` and `found` describe the wrong part of the value."""
    return PydanticCustomError("wrong", "{expected}", {"expected": expected, "key": key, "found": found})


def _text(value: Any) -> str:
    """Check a text without a copy, which would lose the parts of a `Sentence`."""
    if not isinstance(value, str) or not is_one_line(value):
        raise wrong("a text without control characters")
    return value


def _two(ends: list[Any]) -> list[Any]:
    if len(ends) != 2:
        raise wrong("two values")
    return ends


Text = Annotated[str, PlainValidator(_text)]
Figure = Annotated[float, Field(strict=True)]
Number = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e100, le=1e100)]
Flag = Annotated[bool, Field(strict=True)]
Whole = Annotated[int, Field(strict=True, ge=0)]
Ends = Annotated[list[Figure | None], AfterValidator(_two)]


@dataclass(frozen=True)
class Shape:
    """Annotation of a table by the `TypedDict` that it is checked against; for the type checker it stays a `Mapping`."""

    of: Any

    def __get_pydantic_core_schema__(self, _: Any, handler: Any) -> Any:
        return handler.generate_schema(self.of)


def validated(made: type[Made]) -> type[Made]:
    """Let pydantic check a frozen dataclass's fields; a mistake is an `InputError` that names the class and the field."""
    checked: type[Any] = pydantic_dataclass(made, frozen=True)
    names = [field.name for field in fields(checked)]
    init = checked.__init__

    @functools.wraps(init)
    def __init__(self: Any, *args: Any, **kwargs: Any) -> None:
        try:
            init(self, *args, **kwargs)
        except ValidationError as error:
            first = error.errors()[0]
            place = [names[part] if isinstance(part, int) else part for part in first["loc"][:1]]
            said = mistake({**first, "loc": (*place, *first["loc"][1:])})
            raise InputError(f"{type(self).__name__.lower()}: {said}") from None

    checked.__init__ = __init__
    return checked


def require(content: Any, shape: Any, key: str) -> None:
    """Raise `InputError` unless content has a shape, such as a `TypedDict`; the error names the `key`."""
    try:
        TypeAdapter(shape).validate_python(content)
    except ValidationError as error:
        first = error.errors()[0]
        raise InputError(mistake({**first, "loc": (key, *first["loc"])})) from None


def mistake(error: ErrorDetails) -> str:
    """Describe a mistake in one line: the key, the value found, and the expectation."""
    context, found = error.get("ctx", {}), error["input"]
    if context.get("key"):
        found = context["found"]
    key = ".".join(str(part) for part in (*error["loc"], context.get("key")) if part not in (None, ""))
    words = WORDS.get(error["type"], "").format(**context) or error["msg"].removeprefix("Input should be ")
    return f"{key}: found {'nothing' if error['type'] == 'missing' else shown(found)}, expected {words}"
