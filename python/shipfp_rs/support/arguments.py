"""Checks of the arguments of public functions against their annotations and valid ranges."""

from __future__ import annotations

import builtins
import functools
import inspect
import itertools
import math
import numbers
import sys
import types
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.support.arrays import unmasked

MOST_SAMPLES = 200_000_000
"""Largest number of samples of a generated signal."""
ACCURACIES_PCT = (1e-3, 1e3)
"""Range of target accuracies [%]."""
HIDDEN = frozenset(("Cc", "Cs", "Zl", "Zp"))
"""Unicode categories of control characters, surrogates, and separators of lines and paragraphs."""
TURNING = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
"""Characters that change the text direction and so may make a text look different from its content."""
LINES = {ord("\n"): " ", ord("\t"): " "}
"""Translation table for the control characters permitted in texts of several lines."""


def is_one_line(text: str) -> bool:
    """Whether a text is one line without control characters."""
    return not any(unicodedata.category(letter) in HIDDEN or letter in TURNING for letter in text)


def at_most(name: str, samples: float) -> int:
    """Convert a number of samples to an integer; `InputError` above the limit of a signal."""
    if not 0.0 <= samples <= MOST_SAMPLES:
        raise InputError(f"{name}: {samples:.3g} samples, expected 0 to {MOST_SAMPLES}")
    return round(samples)


def positive(name: str, value: float) -> None:
    """Raise `InputError` unless a value is finite and positive."""
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{name} is {value}, expected a positive number")


def between(name: str, value: float, low: float, high: float) -> None:
    """Raise `InputError` for a number outside a range, or NaN."""
    if not low <= value <= high:
        raise InputError(f"{name} is {value:g}, expected {low:g} to {high:g}")


def accuracy(percent: float) -> None:
    """Raise `InputError` for a target accuracy [%] outside the range that is possible in trials."""
    between("accuracy_pct", percent, *ACCURACIES_PCT)


def one_of(name: str, value: str, known: Iterable[str]) -> str:
    """Return a known word; `InputError` for any other."""
    known = tuple(known)
    if value not in known:
        raise InputError(f"{name} is {value!r}, expected one of {', '.join(known)}")
    return value


def expect(holds: bool, key: str, found: object, expected: str) -> None:
    """Raise `InputError` unless a condition holds; the text names the key, the value (shortened) and the expectation."""
    if not holds:
        raise InputError(f"{key}: found {shown(found)}, expected {expected}")


def shown(value: object) -> str:
    """`repr` of a value, shortened to 60 characters; for a very long integer, its number of digits."""
    if isinstance(value, int) and value.bit_length() > 1000:  # Python refuses to print longer numbers
        return f"a whole number of {round(value.bit_length() * math.log10(2.0))} digits"
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


F = TypeVar("F", bound=Callable[..., Any])
Misfit = tuple[tuple[Any, ...], Any, str]
"""Mismatch: keys and indices that lead to the wrong entry, the entry, and the expected type in words."""

LOOKED_AT = 1000
"""Number of entries of a sequence that are checked against its annotation; functions check arrays themselves."""


@dataclass(frozen=True, eq=False)
class Rule:
    """Rule from an annotation: the expected type in words, a test, rules of the entries, and alternative rules."""

    words: str
    holds: Callable[[Any], bool] = lambda value: True
    entries: Callable[[Any], Iterable[tuple[Any, Any, Rule]]] = lambda value: ()
    options: Sequence[Rule] = ()

    def misfit(self, value: Any) -> Misfit | None:
        """Innermost entry that does not match the rule; None if the value matches."""
        if not self.holds(value):
            return (), value, self.words
        found = []
        for option in self.options:
            if (one := option.misfit(value)) is None:
                return None
            found.append(one)
        if found:
            deepest = max(found, key=lambda one: len(one[0]))
            return deepest if deepest[0] else ((), value, self.words)
        for key, entry, rule in self.entries(value):
            if (one := rule.misfit(entry)) is not None:
                return (key, *one[0]), one[1], one[2]
        return None


def _is_number(value: Any, kind: type = numbers.Real) -> bool:
    """Whether a value is a number that NumPy can represent; NumPy limits the size of integers. Booleans are not numbers."""
    if type(value) is float and kind is numbers.Real:  # the usual case
        return True
    if isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "iuf":
        value = value[()]
    if not isinstance(value, kind) or isinstance(value, bool | np.bool_):
        return False
    return not isinstance(value, int) or abs(value) < 2**63


ALL = Rule("anything")
PLAIN: Mapping[Any, Rule] = {
    Any: ALL,
    float: Rule("a number", _is_number),
    int: Rule("a whole number", lambda value: _is_number(value, numbers.Integral)),
    str: Rule("a text", lambda value: isinstance(value, str)),
    bool: Rule("True or False", lambda value: isinstance(value, bool | np.bool_)),
    type(None): Rule("None", lambda value: value is None),
}
Positive = Annotated[float, Rule("a positive number", lambda value: 0.0 < value < math.inf)]
NotNegative = Annotated[float, Rule("zero or a positive number", lambda value: 0.0 <= value < math.inf)]
Count = Annotated[int, Rule("a whole number of 1 or more", lambda value: value >= 1)]
Whole = Annotated[int, Rule("a whole number of 0 or more", lambda value: value >= 0)]


def checked(function: F) -> F:
    """Decorator that rejects arguments of types other than annotated; the function itself checks the contents of arrays.

    Raises
    ------
    InputError
        For such an argument; the text names the function, the argument, its value and the expected type.
    """
    signature = inspect.signature(function)
    rest = next((one.name for one in signature.parameters.values() if one.kind is one.VAR_KEYWORD), "")

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        args = tuple(map(_plain, args))
        kwargs = {name: _plain(value) for name, value in kwargs.items()}
        try:
            given = signature.bind(*args, **kwargs).arguments
        except TypeError:
            return function(*args, **kwargs)  # raises Python's TypeError for missing or surplus arguments
        given |= given.pop(rest, {})
        _require(function.__name__, function, given)
        try:
            return function(*args, **kwargs)
        except OverflowError as error:
            raise InputError(
                f"{function.__name__}: a number is too large ({error}), expected a number of usual size"
            ) from error

    call.__kwdefaults__ = function.__kwdefaults__  # type: ignore[attr-defined]
    return call  # type: ignore[return-value]


def _plain(value: Any) -> Any:
    """Convert NumPy numbers, whose arithmetic may overflow, to Python numbers, and masked values to NaN."""
    if isinstance(value, np.ma.MaskedArray) and value.dtype.kind in "biuf":
        return unmasked(value)
    if isinstance(value, np.integer | np.floating):
        return value.item()
    return value


def check_fields(made: Any, label: str) -> None:
    """Reject fields of a dataclass whose type differs from the annotation; `label` names the object in errors.

    NumPy numbers, including 0-d arrays, are converted to Python numbers, which can be written to files.
    """
    given = {field.name: getattr(made, field.name) for field in fields(made)}
    for name, value in given.items():
        if isinstance(value, np.generic | np.ndarray) and value.ndim == 0 and value.dtype.kind in "iuf":
            given[name] = value.item()
            object.__setattr__(made, name, given[name])
        elif isinstance(value, str) and not is_one_line(value):
            raise InputError(f"{label}: {name} is {told(value)}, expected a text without control characters")
    _require(label, type(made), given)


def _require(label: str, owner: Any, given: Mapping[str, Any]) -> None:
    rules = _rules(owner)
    for name, value in given.items():
        misfit = rules.get(name, rules[""]).misfit(value)
        if misfit is None:
            continue
        place, found, expected = misfit
        others = (key for key, its in given.items() if _swapped(rules, name, key, value, its))
        advice = "".join(f"; swap it with {other}" for other in itertools.islice(others, 1))
        where = f"{name}{''.join(f'[{key!r}]' for key in place)}"
        raise InputError(f"{label}: {where} is {told(found)}, expected {expected}{advice}")


def _swapped(rules: Mapping[str, Rule], name: str, other: str, value: Any, its: Any) -> bool:
    """Whether two arguments would both match their annotations if they were exchanged."""
    if name == other or not {name, other} <= rules.keys() or its is None or value is None:
        return False
    return rules[other].misfit(value) is None and rules[name].misfit(its) is None


@functools.cache
def _rules(owner: Any) -> Mapping[str, Rule]:
    """Rules of a function's arguments, or of a dataclass's fields, by name; "" for any other name."""
    hints = {"": Any, **_hints(owner)}
    for name, parameter in inspect.signature(owner).parameters.items():
        hint = hints.setdefault(name, Any)
        if parameter.kind is parameter.VAR_POSITIONAL:
            hints[name] = tuple[hint, ...]  # type: ignore[valid-type]
        elif parameter.kind is parameter.VAR_KEYWORD:
            hints[""] = hint
    return {name: _rule(hint) for name, hint in hints.items()}


@functools.cache
def _hints(owner: Any) -> Mapping[str, Any]:
    """Annotations; a name imported only for type checkers is resolved from the package's public names, or else is `Any`."""
    try:
        return get_type_hints(owner, include_extras=True)
    except NameError:
        names = _Names(vars(inspect.getmodule(owner)))
        annotations = inspect.get_annotations(owner)
        return get_type_hints(
            types.SimpleNamespace(__annotations__=annotations), {}, names, include_extras=True
        )


class _Names(dict[str, Any]):
    """Names of a module, extended by the package's public names, since a module may import those only for type checkers."""

    def __missing__(self, name: str) -> Any:
        if hasattr(builtins, name):
            raise KeyError(name)
        return getattr(sys.modules["shipfp_rs"], name, Any)


@functools.cache
def _rule(hint: Any) -> Rule:
    """Rule of an annotation; for an annotation that can't be checked, a rule that all values match."""
    origin, inner = get_origin(hint), get_args(hint)
    kind = origin if inspect.isclass(origin) else object
    if hint in PLAIN:
        return PLAIN[hint]
    if hint == npt.ArrayLike or kind is np.ndarray:
        single = numbers.Number if kind is np.ndarray else bool | np.bool_
        may_turn = kind is np.ndarray and "complex" in str(inner)
        words, kinds = ("numbers", "biufc") if may_turn else ("real numbers", "biuf")
        return Rule(f"an array of {words}", lambda v: not isinstance(v, single) and _is_array(v, kinds))
    if origin is Annotated:
        base, own = _rule(inner[0]), inner[1]
        return Rule(own.words, lambda value: base.misfit(value) is None and own.holds(value))
    if origin in (Union, types.UnionType):
        options = [_rule(one) for one in _options(inner)]
        return Rule(" or ".join(dict.fromkeys(one.words for one in options)), options=options)
    if origin is Literal:
        *others, last = map(repr, inner)
        words = f"{', '.join(others)} or {last}" if others else last
        return Rule(words, lambda v: any(type(v) is type(one) and v == one for one in inner))
    if issubclass(kind, Mapping | Iterable):
        return _rule_of_entries(kind, inner)
    if Callable in (hint, origin):
        return Rule("a function", callable)
    checkable = not getattr(hint, "_is_protocol", False) or getattr(hint, "_is_runtime_protocol", False)
    if inspect.isclass(hint) and origin is None and checkable:
        return Rule(_a(hint), lambda value: isinstance(value, hint))
    return ALL


def _options(inner: tuple[Any, ...]) -> tuple[Any, ...]:
    """Options of a union; `ArrayLike` is itself a union, but stays one option."""
    of_arrays = get_args(npt.ArrayLike)
    if set(of_arrays) <= set(inner):
        return (npt.ArrayLike, *(one for one in inner if one not in of_arrays))
    return inner


def _rule_of_entries(kind: type, inner: tuple[Any, ...]) -> Rule:
    """Rule of a mapping, a tuple or a sequence."""
    rules = [_rule(one) for one in inner if one is not Ellipsis]
    if issubclass(kind, Mapping):
        key, entry = rules
        return Rule(
            f"a mapping from {key.words} to {entry.words}",
            lambda value: isinstance(value, Mapping) and all(key.misfit(one) is None for one in value),
            lambda value: ((name, one, entry) for name, one in value.items()),
        )
    if kind is tuple and Ellipsis not in inner:
        return Rule(
            f"({', '.join(one.words for one in rules)})",
            lambda value: isinstance(value, tuple | list) and len(value) == len(rules),
            lambda value: zip(itertools.count(), value, rules, strict=False),
        )
    if kind not in (tuple, Iterable) and not issubclass(kind, Sequence):
        return ALL
    return Rule(
        f"a list, each {rules[0].words}",
        lambda value: _is_sequence(value, kind, inner[0]),
        # Iterators, which would be consumed, and arrays, which are checked as a whole, have no entries to check.
        lambda value: (
            ((place, one, rules[0]) for place, one in enumerate(itertools.islice(value, LOOKED_AT)))
            if not isinstance(value, Iterator | np.ndarray)
            else ()
        ),
    )


def _is_array(value: Any, kinds: str) -> bool:
    """Whether NumPy converts a value to numbers of the given `numpy.dtype.kind`s."""
    try:
        given = np.asarray(value)
    except ValueError:  # rows of different lengths
        return False
    if given.dtype.kind == "O":
        # Also accepted: integers of any size, and None for missing values, as in pandas and JSON.
        entries = [one for one in given.ravel() if one is not None]
        return bool(entries) and all(isinstance(one, numbers.Real) for one in entries)
    return given.dtype.kind in kinds


def _is_sequence(value: Any, kind: type, hint: Any) -> bool:
    if kind is tuple or isinstance(value, tuple | list | str | bytes | Mapping):
        return isinstance(value, tuple | list)
    if isinstance(value, np.ndarray):
        numeric = hint in (float, int) and value.dtype.kind in "iuf"
        return value.ndim > 0 and (
            numeric or all(_rule(hint).misfit(one) is None for one in value[:LOOKED_AT])
        )
    once = kind is Iterable and isinstance(value, Iterator)
    return once or (hasattr(value, "__len__") and hasattr(value, "__iter__"))


def told(value: Any) -> str:
    """Short text for a value, for error messages."""
    if value is None or isinstance(value, bool | numbers.Number | str):
        return shown(value)
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype}"
    if isinstance(value, list | tuple) and value and len({type(one) for one in value}) == 1:
        return f"a {type(value).__name__} of {type(value[0]).__name__}"
    return _a(type(value))


def _a(kind: type) -> str:
    return f"{'an' if kind.__name__[:1] in 'AEIOUaeiou' else 'a'} {kind.__name__}"
