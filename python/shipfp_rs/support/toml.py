"""Configuration from TOML files, checked by a pydantic model; the first mistake becomes one line of help."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from shipfp_rs.errors import InputError
from shipfp_rs.support.hints import suggestion

Model = TypeVar("Model", bound=BaseModel)


class Section(BaseModel):
    """Base of every table of a configuration file: immutable, no unknown keys, no conversion of types."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


def unexpected(key: str, found: object, expected: str) -> PydanticCustomError:
    """Return the error for a validator of several keys to raise; `key` is relative to its section."""
    return PydanticCustomError("unexpected", "{expected}", {"key": key, "found": found, "expected": expected})


def read_toml(path: str | Path, model: type[Model]) -> Model:
    """Read a TOML file into a pydantic model.

    Parameters
    ----------
    path
        File to read, UTF-8.
    model
        Class of the result, usually derived from `Section`.

    Raises
    ------
    InputError
        Where the file can't be read, is not TOML, or holds a key or value that the model refuses: one line,
        "file: key: found ..., expected ...".
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}; expected a TOML file") from error
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: found bytes that are not UTF-8 at {error.start}, expected a TOML file"
        ) from error
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not TOML: {error}") from error
    return validated(content, model, str(path))


def built_in(kind: str) -> dict[str, Path]:
    """Return the files of a kind ("vessels", "sweeps") that come with the package, by name."""
    folder = Path(str(resources.files("shipfp_rs") / "data" / kind))
    return {path.stem: path for path in sorted(folder.glob("*.toml"), key=lambda path: path.stem)}


def template(name: str) -> str:
    """Return the text of a commented configuration file to fill in, "TRIAL" or "SWEEP"."""
    return built_in("templates")[name].read_text(encoding="utf-8")


def read_named(name_or_path: str | Path, model: type[Model], kind: str, key: str, what: str) -> Model:
    """Read what comes with the package, by its name, or a file of the user's own, by its path.

    Parameters
    ----------
    name_or_path
        Either; a name goes before a file that is called so.
    model
        As for `read_toml`.
    kind
        As for `built_in`.
    key, what
        What is asked for, as a message calls it: a key such as "vessel", and what it is, such as "ship".

    Raises
    ------
    InputError
        Where there is neither, or as `read_toml`.
    """
    name, known = str(name_or_path), built_in(kind)
    path = known.get(name, Path(name_or_path))
    if name not in known and path.suffix != ".toml" and not path.exists():
        raise InputError(
            f"{key} {name!r}: found no built-in {what} of this name, {suggestion(name, [*known])} "
            f"(a {what} of your own is given by the path of its .toml file)"
        )
    return read_toml(path, model)


def validated(content: Mapping[str, Any], model: type[Model], source: str) -> Model:
    """Check already parsed `content`; `source` opens the message of the `InputError` where it fails."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        first, *others = error.errors()
        if first["type"] == "missing":
            # Where its section also holds an unknown key, the missing one is likely misspelt.
            unknown = [other for other in others if other["type"] == "extra_forbidden"]
            first = next((other for other in unknown if other["loc"][:-1] == first["loc"][:-1]), first)
        missing = [".".join(map(str, each["loc"])) for each in error.errors() if each["type"] == "missing"]
        if first["type"] == "missing" and len(missing) > 1:
            raise InputError(
                f"{source}: {', '.join(missing)}: found nothing, expected these keys to be given"
            ) from error
        raise InputError(f"{source}: {_one_line(first, model)}") from error


def _one_line(error: ErrorDetails, model: type[BaseModel]) -> str:
    location = [str(part) for part in error["loc"]]
    match error["type"]:
        case "unexpected":
            context = error["ctx"]
            key = ".".join([*location, context["key"]])
            return f"{key}: found {context['found']}, expected {context['expected']}"
        case "extra_forbidden":
            known = sorted(
                {key for owner in _models_at(model, error["loc"][:-1]) for key in owner.model_fields}
            )
            return f"{'.'.join(location)}: found an unknown key, {suggestion(location[-1], known)}"
        case "missing":
            return f"{'.'.join(location)}: found nothing, expected this key to be given"
        case "model_type" | "dict_type":
            expected = "a table"
        case "float_type" | "int_type" if isinstance(error["input"], str):
            expected = "a valid number, without quotes"
        case "tuple_type" | "list_type":
            expected = "a list"
        case _:
            expected = error["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    return f"{'.'.join(location)}: found {_shown(error['input'])}, expected {expected}"


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _models_at(model: type[BaseModel], location: Sequence[int | str]) -> set[type[BaseModel]]:
    """Return the models that may stand at `location`; list indices and tags of unions lead nowhere new."""
    found = {model}
    for part in location:
        inner = {nested for owner in found for nested in _models_in(_annotation(owner, str(part)))}
        found = inner or found
    return found


def _annotation(owner: type[BaseModel], key: str) -> Any:
    """Type of a key, or of any table under a name of the user's own where the model takes such."""
    field = owner.model_fields.get(key)
    return field.annotation if field else get_type_hints(owner).get("__pydantic_extra__")


def _models_in(annotation: Any) -> set[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return {annotation}
    return {nested for argument in get_args(annotation) for nested in _models_in(argument)}
