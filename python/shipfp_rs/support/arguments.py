"""Arguments of public functions checked against their annotations: one clear line instead of an error deep inside."""

from __future__ import annotations

import builtins
import functools
import inspect
import math
import numbers
import sys
import types
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import fields, is_dataclass
from typing import Annotated, Any, Literal, Protocol, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.support.arrays import unmasked
from shipfp_rs.support.checks import is_one_line

F = TypeVar("F", bound=Callable[..., Any])

LOOKED_AT = 1000
"""Number of a sequence's entries that are checked against its annotation; arrays are checked where they are used."""
PLAIN: Mapping[Any, str] = {
    float: "a number",
    int: "a whole number",
    str: "a text",
    bool: "True or False",
    type(None): "None",
}


class _Range(Protocol):
    words: str

    def __call__(self, value: Any) -> bool: ...


class _Positive:
    words = "a positive number"

    def __call__(self, value: Any) -> bool:
        return bool(math.isfinite(value) and value > 0.0)


class _AtLeast:
    def __init__(self, least: int) -> None:
        self.least, self.words = least, f"a whole number of {least} or more"

    def __call__(self, value: Any) -> bool:
        return bool(value >= self.least)


Positive = Annotated[float, _Positive()]
Count = Annotated[int, _AtLeast(1)]
Whole = Annotated[int, _AtLeast(0)]


def checked(function: F) -> F:
    """Return a function that refuses arguments which its annotations exclude; what an array holds is left to it.

    Raises
    ------
    InputError
        On a call with such an argument: the function, the argument, what was found and what was expected.
    """
    signature = inspect.signature(function)

    @functools.cache
    def hints() -> Mapping[str, Any]:
        return _hints(function)

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        args = tuple(map(_plain, args))
        kwargs = {name: _plain(value) for name, value in kwargs.items()}
        try:
            given = signature.bind(*args, **kwargs).arguments
        except TypeError:
            return function(*args, **kwargs)  # Python's own words for what is missing or too much
        _require(function.__name__, given, hints(), signature.parameters)
        try:
            return function(*args, **kwargs)
        except OverflowError as error:
            raise InputError(
                f"{function.__name__}: a number is too large ({error}), expected one that such data can have"
            ) from error

    call.__kwdefaults__ = function.__kwdefaults__  # type: ignore[attr-defined]
    return call  # type: ignore[return-value]


def _plain(value: Any) -> Any:
    """Return Python's own number in place of NumPy's small ones, which wrap, and NaN for what is masked."""
    if isinstance(value, np.ma.MaskedArray) and value.dtype.kind in "biuf":
        return unmasked(value)
    if isinstance(value, np.integer | np.floating):
        return value.item()
    return value


def check_fields(made: Any, label: str) -> None:
    """Refuse values of a dataclass that its annotations exclude; `label` says in errors which object it is."""
    assert is_dataclass(made)
    hints = _hints(made.__class__)
    for field in fields(made):
        value = getattr(made, field.name)
        if isinstance(value, str) and not is_one_line(value):
            raise InputError(
                f"{label}: {field.name} is {told(value)}, expected a text without control characters"
            )
        if not fits(value, hints.get(field.name, Any)):
            where, found, expected = _culprit(field.name, value, hints[field.name])
            raise InputError(f"{label}: {where} is {told(found)}, expected {words(expected)}")


def _is_array(value: Any, kinds: str) -> bool:
    """Whether NumPy makes numbers of a value; `kinds` are those of `numpy.dtype.kind` that will do."""
    try:
        given = np.asarray(value)
    except ValueError:  # rows of different lengths
        return False
    if given.dtype.kind == "O":
        # Whole numbers of any size, or None for what is missing, as pandas and JSON have it.
        entries = [one for one in given.ravel() if one is not None]
        return bool(entries) and all(isinstance(one, numbers.Real) for one in entries)
    return given.dtype.kind in kinds


@functools.cache
def _hints(owner: Any) -> Mapping[str, Any]:
    """Return the annotations; a name that only type checkers load is looked up among the public ones, or fits all."""
    try:
        return get_type_hints(owner, include_extras=True)
    except NameError:
        names = _Names(vars(inspect.getmodule(owner)))
        annotations = inspect.get_annotations(owner)
        return get_type_hints(
            types.SimpleNamespace(__annotations__=annotations), {}, names, include_extras=True
        )


class _Names(dict[str, Any]):
    """Names of a module, and beside them the package's public ones, which a type checker only may have loaded."""

    def __missing__(self, name: str) -> Any:
        if hasattr(builtins, name):
            raise KeyError(name)
        return getattr(sys.modules["shipfp_rs"], name, Any)


def _require(
    function: str,
    given: Mapping[str, Any],
    hints: Mapping[str, Any],
    parameters: Mapping[str, inspect.Parameter],
) -> None:
    for name, value in given.items():
        hint = hints.get(name, Any)
        if parameters[name].kind is inspect.Parameter.VAR_KEYWORD:
            entries = value.items()
        elif parameters[name].kind is inspect.Parameter.VAR_POSITIONAL:
            entries = [(name, one) for one in value]
        else:
            entries = [(name, value)]
        for label, one in entries:
            if fits(one, hint):
                continue
            other = next((key for key, v in given.items() if _swapped(name, key, one, v, hints)), None)
            advice = f"; swap it with {other}" if other else ""
            where, found, expected = _culprit(label, one, hint)
            raise InputError(f"{function}: {where} is {told(found)}, expected {words(expected)}{advice}")


def _culprit(label: str, value: Any, hint: Any) -> tuple[str, Any, Any]:
    """Return the entry of a mapping or sequence that does not fit, with its place; the value itself if it is neither."""
    for option in _options(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,):
        origin, inner = get_origin(option), get_args(option)
        if not inspect.isclass(origin):
            continue
        if issubclass(origin, Mapping) and isinstance(value, Mapping):
            entries, kind = list(value.items()), inner[1]
        elif (
            issubclass(origin, (Sequence, Iterable))
            and origin not in (tuple, np.ndarray)
            and isinstance(value, list | tuple)
        ):
            entries, kind = list(enumerate(value)), inner[0]
        else:
            continue
        for key, entry in entries:
            if not fits(entry, kind):
                return _culprit(f"{label}[{key!r}]", entry, kind)
    return label, value, hint


def _swapped(name: str, other: str, value: Any, its: Any, hints: Mapping[str, Any]) -> bool:
    """Whether two arguments would both fit if each stood in the other's place."""
    if name == other or other not in hints or name not in hints or its is None or value is None:
        return False
    return fits(value, hints[other]) and fits(its, hints[name])


def fits(value: Any, hint: Any) -> bool:
    """Whether a value is of the type that an annotation names; an annotation that tells nothing fits all."""
    origin, inner = get_origin(hint), get_args(hint)
    if hint is Any:
        return True
    if origin is np.ndarray:
        numbers_of = "biufc" if "complex" in str(hint) else "biuf"
        return not isinstance(value, numbers.Number) and _is_array(value, numbers_of)
    if hint == npt.ArrayLike:
        return not isinstance(value, bool | np.bool_) and _is_array(value, "biuf")
    if origin is Annotated:
        return fits(value, inner[0]) and all(rule(value) for rule in inner[1:] if callable(rule))
    if origin in (Union, types.UnionType):
        return any(fits(value, one) for one in _options(hint))
    if origin is Literal:
        return any(type(value) is type(one) and value == one for one in inner)
    if origin is tuple:
        return _fits_tuple(value, inner)
    if inspect.isclass(origin) and issubclass(origin, Mapping):
        return isinstance(value, Mapping) and all(
            fits(key, inner[0]) and fits(one, inner[1]) for key, one in value.items()
        )
    if inspect.isclass(origin) and issubclass(origin, Sequence):
        return _fits_sequence(value, inner[0])
    if origin is Iterable:
        # What can be gone through only once is not looked at.
        once = isinstance(value, Iterator)
        return once or isinstance(value, Set) or _fits_sequence(value, inner[0])
    if origin is Callable or hint is Callable:
        return callable(value)
    return _fits_plain(value, hint)


def _options(hint: Any) -> tuple[Any, ...]:
    """Return what a union is one of; `ArrayLike`, itself a union with texts, stays whole."""
    inner, of_arrays = get_args(hint), get_args(npt.ArrayLike)
    if set(of_arrays) <= set(inner):
        return (npt.ArrayLike, *(one for one in inner if one not in of_arrays))
    return inner


def _fits_plain(value: Any, hint: Any) -> bool:
    if hint is None or hint is type(None):
        return value is None
    if isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "iuf":
        value = value[()]
    if hint is float:
        # NumPy does not take whole numbers of any size for numbers.
        beyond = isinstance(value, int) and abs(value) >= 2**63
        return isinstance(value, numbers.Real) and not isinstance(value, bool | np.bool_) and not beyond
    if hint is int:
        whole = isinstance(value, numbers.Integral) and not isinstance(value, bool | np.bool_)
        return whole and abs(int(value)) < 2**63
    if hint is bool:
        return isinstance(value, bool | np.bool_)
    if inspect.isclass(hint) and not getattr(hint, "_is_protocol", False) and get_origin(hint) is None:
        return isinstance(value, hint)
    return True


def _fits_sequence(value: Any, inner: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim > 0 and (
            value.dtype.kind in "iuf"
            if inner in (float, int)
            else all(fits(one, inner) for one in value[:LOOKED_AT])
        )
    if (
        isinstance(value, str | bytes | Mapping)
        or not hasattr(value, "__len__")
        or not hasattr(value, "__iter__")
    ):
        return False
    return all(fits(one, inner) for _, one in zip(range(LOOKED_AT), value, strict=False))


def _fits_tuple(value: Any, inner: tuple[Any, ...]) -> bool:
    if not isinstance(value, tuple | list):
        return False
    if len(inner) == 2 and inner[1] is Ellipsis:
        return all(fits(one, inner[0]) for one in value)
    return len(value) == len(inner) and all(map(fits, value, inner))


def words(hint: Any) -> str:
    """Return what an annotation asks for, as a sentence has it."""
    origin, inner = get_origin(hint), get_args(hint)
    if hint == npt.ArrayLike or origin is np.ndarray:
        return "an array of numbers" if "complex" in str(inner) else "an array of real numbers"
    if hint in PLAIN or hint is None:
        return PLAIN.get(hint, "None")
    if origin is Annotated:
        return next((rule.words for rule in inner[1:] if hasattr(rule, "words")), words(inner[0]))
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(words(one) for one in _options(hint)))
    if origin is Literal:
        *others, last = map(repr, inner)
        return f"{', '.join(others)} or {last}" if others else last
    if inspect.isclass(origin) and issubclass(origin, Mapping):
        return f"a mapping from {words(inner[0])} to {words(inner[1])}"
    if origin is tuple and Ellipsis not in inner:
        return f"({', '.join(words(one) for one in inner)})"
    if origin in (tuple, Iterable) or (inspect.isclass(origin) and issubclass(origin, Sequence)):
        return f"a list, each {words(inner[0])}"
    if origin is Callable or hint is Callable:
        return "a function"
    name = getattr(hint, "__name__", "")
    return (
        f"{'an' if name[:1] in 'AEIOUaeiou' else 'a'} {name}"
        if inspect.isclass(hint)
        else "an array of numbers"
    )


def told(value: Any) -> str:
    """Return what was found, short."""
    if value is None or isinstance(value, bool | numbers.Number | str):
        shown = repr(value)
        return shown if len(shown) <= 60 else f"{shown[:57]}..."
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype}"
    if isinstance(value, list | tuple) and value and len({type(one) for one in value}) == 1:
        return f"a {type(value).__name__} of {type(value[0]).__name__}"
    name = type(value).__name__
    return f"{'an' if name[:1] in 'AEIOUaeiou' else 'a'} {name}"
