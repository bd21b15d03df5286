"""Writes background/keys.md: every key of TRIAL.toml, of a vessel file and of SWEEP.toml, from the models that read them.

python docs/keys.py
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from shipfp_rs.processing.trial import Trial
from shipfp_rs.sweeps.plan import Plan
from shipfp_rs.vessel.vessel import Vessel

PAGE = Path(__file__).parent / "background" / "keys.md"
FILES = {
    "TRIAL.toml": (Trial, "`shipfp run` reads it, `shipfp init` writes it."),
    "VESSEL.toml": (Vessel, "A ship; the key `vessel` in the other two files names this file."),
    "SWEEP.toml": (Plan, "`shipfp sweep` reads it."),
}
HEAD = """# Keys of the files

Made by `python docs/keys.py` from the models that read the files. A key marked *needed* has no
default. A key marked *asked for* may be left out until a calculation needs it; the error then names it. A key without a
default has no value if it is left out.
"""
TOP = "At the top"
WORDS = {float: "number", int: "whole number", bool: "true or false", str: "text", Any: "value"}
UNITS = {
    "rpm_per_V": "rpm/V", "rpm_at_0_V": "rpm", "kg_m2": "kg m²", "kg_m3": "kg/m³", "Nm_rad": "Nm/rad", "Nms_rad": "Nm s/rad",
    "Nm_s": "Nm/s", "mm_s": "mm/s", "N_s2_m2": "N s²/m²", "kW": "kW", "Nm": "Nm", "mm": "mm", "rpm": "rpm", "hz": "Hz",
    "kg": "kg", "deg": "deg", "V": "V", "m": "m", "s": "s",
}  # fmt: skip
"""Ends of keys to their units, longer ones first."""
SIGNALS = ("n_e", "n_s", "M_b", "M_s", "M_g", "X_f")
"""Keys named as signals; s is no second there."""
MOST = 1e7
"""Larger limits only keep slips out, and are not shown."""


def texts_of(model: type[BaseModel]) -> dict[str, str]:
    """Return the docstring of each field of a model, its parents' where it has none of its own."""
    found: dict[str, str] = {}
    for parent in reversed(model.__mro__):
        if not issubclass(parent, BaseModel) or parent is BaseModel:
            continue
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(parent))).body
        for one, following in zip(tree.body, tree.body[1:], strict=False):
            if (
                isinstance(one, ast.AnnAssign)
                and isinstance(following, ast.Expr)
                and isinstance(following.value, ast.Constant)
            ):
                found[one.target.id] = " ".join(str(following.value.value).split())
    return found


def _tables(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the models in an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _tables(part)


def _bounds(metadata: Any) -> str:
    limits = [
        part
        for one in metadata
        for part in (one.metadata if isinstance(one, FieldInfo) else [one])
    ]
    signs = {"gt": "above", "ge": "from", "lt": "below", "le": "to"}
    told = [
        f" {sign} {getattr(one, key):g}"
        for key, sign in signs.items()
        for one in limits
        if abs(getattr(one, key, 2 * MOST)) <= MOST
    ]
    return "".join(told)


def type_of(annotation: Any, metadata: Any = ()) -> str:
    """Return what a value has to be, in words."""
    origin, parts = (
        get_origin(annotation),
        [part for part in get_args(annotation) if part is not type(None)],
    )
    if origin is Annotated:
        return type_of(parts[0], parts[1:] if isinstance(parts[0], type) else metadata)
    if origin in (Union, UnionType):
        return " or ".join(type_of(part, metadata) for part in parts)
    if origin is Literal:
        return ", ".join(f'"{part}"' for part in parts)
    if origin is tuple:
        if Ellipsis in parts:
            return "list of " + re.sub(r"^(number|text|table)", r"\1s", type_of(parts[0]))
        return f"[{', '.join(map(type_of, parts))}]"
    if origin is dict:
        return "table"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "table"
    return WORDS[annotation] + (_bounds(metadata) if annotation in (float, int) else "")


def _default(field: FieldInfo, text: str) -> str:
    if field.is_required():
        return "may be left out" if "left out" in text else "*needed*"
    value = field.get_default(call_default_factory=True)
    if value is None:
        return "" if type(None) in get_args(field.annotation) else "*asked for*"
    if isinstance(value, BaseModel) or value in ({}, ()):
        return ""
    return f"`{json.dumps(value)}`"


def _unit(name: str, kind: str, text: str) -> str:
    """Return the unit that a key's name ends with, else the one that the text says of a number."""
    if name in SIGNALS or "number" not in kind:
        return ""
    said = re.search(r"\[(1/s|s)\]", text)
    own = (unit for end, unit in UNITS.items() if name == end or name.endswith(f"_{end}"))
    return next(own, said[1] if said else "")


def _sections(
    model: type[BaseModel], path: str = "", wrap: str = "[{}]"
) -> Iterator[tuple[str, type[BaseModel]]]:
    """Yield each table's heading and its model."""
    yield wrap.format(path) if path else TOP, model
    extra = inspect.get_annotations(model, eval_str=True).get("__pydantic_extra__")
    fields = {name: field.annotation for name, field in model.model_fields.items()}
    for name, annotation in {**fields, **({"NAME": extra} if extra else {})}.items():
        for inner in _tables(annotation):
            several = get_origin(annotation) is tuple
            key = f'{name}."KEY"' if get_origin(annotation) is dict and name != "NAME" else name
            yield from _sections(
                inner, f"{path}.{key}".lstrip("."), "[[{}]]" if several else "[{}]"
            )


def _cell(text: str) -> str:
    without = re.sub(r"\bNone:", "without it:", text)
    return re.sub(r"([*|<])", r"\\\1", re.sub(r"(^|\. )without it:", r"\1Without it:", without))


def _section(model: type[BaseModel], headings: list[str]) -> Iterator[str]:
    """Yield the lines of one table of a file."""
    yield (
        "### "
        + (TOP if headings == [TOP] else ", ".join(f"`{one}`" for one in headings))
        + "\n"
    )
    yield _cell(_about(model)) + "\n"
    yield "| key | type | unit | default | meaning |\n|---|---|---|---|---|"
    texts = texts_of(model)
    for name, field in model.model_fields.items():
        kind = type_of(field.annotation, field.metadata)
        text = texts.get(name, "")
        if not text or text.startswith("None:"):
            text = " ".join([*map(_about, _tables(field.annotation)), text]).strip()
        yield f"| `{name}` | {kind} | {_unit(name, kind, text)} | {_default(field, text)} | {_cell(text)} |"
    yield ""


def _about(model: type[BaseModel]) -> str:
    return " ".join((inspect.getdoc(model) or "").split("\n\n")[0].split())


def page() -> str:
    """Return the page."""
    lines, shown = [HEAD], {}
    for file, (root, about) in FILES.items():
        lines += [f"## {file}\n", f"{about}\n"]
        named: dict[type[BaseModel], list[str]] = {}
        for heading, model in _sections(root):
            named.setdefault(model, []).append(heading)
        for model, headings in named.items():
            same = shown.setdefault(tuple(texts_of(model).items()), (file, headings[0]))
            if same[0] != file:
                lines += [
                    f"### `{headings[0]}`\n",
                    f"{_about(model)} Its keys: `{same[1]}` of {same[0]}.\n",
                ]
            else:
                lines += _section(model, headings)
    return "\n".join(lines).rstrip("\n") + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
