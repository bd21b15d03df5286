"""Line of discs, shafts and gears from a torsional calculation, reduced to inertias about a gauge and a stiffness."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Self

from pydantic import Field

from shipfp_rs.errors import InputError
from shipfp_rs.support.files import read_json
from shipfp_rs.support.hints import suggestion
from shipfp_rs.support.tables import package
from shipfp_rs.support.toml import Section, read_tables, validated

Node = Annotated[int, Field(ge=0)]


class Disc(Section):
    """A rigid mass on a node; discs on one node turn together. The default name is "disc" and a number that starts at 1."""

    name: str = ""
    node: Node
    inertia_kg_m2: Annotated[float, Field(ge=0.0)]


class Link(Section):
    """A shaft, by default named "shaft" and a number, or a gear, between two nodes; its inertia is halved between them."""

    name: str = ""
    nodes: Annotated[tuple[Node, Node], Field(strict=False)]
    ratio: Annotated[float, Field(gt=0.0)] = 1.0
    """Speed of the first node divided by that of the second."""
    stiffness_Nm_rad: Annotated[float, Field(gt=0.0)] | None = None
    """Torsional stiffness, referred to the first node; None: rigid."""
    inertia_kg_m2: Annotated[float, Field(ge=0.0)] = 0.0


class Seen(NamedTuple):
    """Line referred to its propeller: total inertia and the part behind a gauge [kg m2], stiffness [Nm/rad], gear ratio."""

    inertia: float | None
    propeller_side_inertia: float | None
    stiffness: float | None
    ratio: float


class Line(Section):
    """Discs, shafts and gears of one drive train."""

    discs: Annotated[tuple[Disc, ...], Field(strict=False, min_length=1)]
    """Discs in order; the first is the engine, the last the propeller."""
    shafts: Annotated[tuple[Link, ...], Field(strict=False)] = ()
    gears: Annotated[tuple[Link, ...], Field(strict=False)] = ()

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a line's tables from JSON or TOML, or an assembly from openTorsion's JSON format (TORS)."""
        path, expected = Path(path), "tables discs, shafts and gears of a torsional line"
        found = read_tables(path) if path.suffix == ".toml" else read_json(path, expected)
        if not (isinstance(found, dict) and "components" in found):
            return validated(found if isinstance(found, dict) else {}, cls, str(path))
        try:
            return cls.of_assembly(package("opentorsion", extra="torsion").Assembly.from_tors(found))
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise InputError(f"{path}: openTorsion can't read it, {error!r}; expected {expected}") from error

    @classmethod
    def of_assembly(cls, assembly: Any) -> Self:
        """Return the line of an `opentorsion.Assembly`, whose elements have no names."""
        wheels = [*(assembly.gear_elements or ()), *(assembly.elastic_gear_elements or ())]
        discs = [*(assembly.disk_elements or ())]
        # The first and the last disc must be the ends of the line, so gear wheels are inserted between them.
        content = {
            "discs": [
                {"node": w.node, "inertia_kg_m2": float(w.I)} for w in discs[:-1] + wheels + discs[-1:]
            ],
            "shafts": [
                # The inertia is the sum of all entries of the shaft's mass matrix, since both ends have the same speed.
                {"nodes": [s.nl, s.nr], "stiffness_Nm_rad": float(s.k), "inertia_kg_m2": float(s.M().sum())}
                for s in assembly.shaft_elements
            ],
            "gears": [
                {
                    "nodes": [w.parent.node, w.node],
                    "ratio": w.R / w.parent.R,
                    "stiffness_Nm_rad": getattr(w, "k", None),
                }
                for w in wheels
                if w.parent is not None
            ],
        }
        return validated(content, cls, "opentorsion.Assembly")

    def seen(self, gauge: str | None = None) -> Seen:
        """Return the line referred to its propeller; the gauge is on the named shaft, or behind the named disc."""
        # Inertias are multiplied, and compliances divided, by the square of their speed over the propeller's.
        speeds, before = self._walked(self.discs[-1].node)
        named = {one.name or f"disc {k}": one for k, one in enumerate(self.discs, 1)}
        links = {one.name or f"shaft {k}": one for k, one in enumerate(self.shafts, 1)}
        if gauge is not None and gauge not in {**named, **links}:
            raise InputError(f"torsion.gauge: found {gauge!r}, {suggestion(gauge, [*named, *links])}")
        cut = None if gauge is None else links.get(gauge)
        if gauge is not None and cut is None and (cut := next(_way(named[gauge].node, before), None)) is None:
            raise InputError(f"torsion.gauge: found {gauge!r}, the propeller; expected an element before it")
        masses = [(one.node, one.inertia_kg_m2) for one in self.discs]
        masses += [(end, 0.5 * one.inertia_kg_m2) for one in (*self.shafts, *self.gears) for end in one.nodes]
        parts = [(node, inertia * speeds[node] ** 2) for node, inertia in masses]
        engine = self.discs[0].node
        soft = [
            1.0 / (one.stiffness_Nm_rad * speeds[one.nodes[0]] ** 2)
            for one in _way(engine, before)
            if one.stiffness_Nm_rad is not None
        ]
        return Seen(
            math.fsum(part for _, part in parts),
            None if cut is None else math.fsum(part for node, part in parts if cut not in _way(node, before)),
            1.0 / math.fsum(soft) if soft else None,
            speeds[engine],
        )

    def _walked(self, start: int) -> tuple[dict[int, float], dict[int, tuple[Link, int]]]:
        """Speed of each node over that of `start`; for each other node, the link and the next node towards `start`."""
        speeds, before, left = {start: 1.0}, {}, [*self.shafts, *self.gears]
        while reached := [one for one in left if (one.nodes[0] in speeds) != (one.nodes[1] in speeds)]:
            link, (first, second) = reached[0], reached[0].nodes
            if first in speeds:
                speeds[second], before[second] = speeds[first] / link.ratio, (link, first)
            else:
                speeds[first], before[first] = speeds[second] * link.ratio, (link, second)
            left.remove(link)
        apart = [one.nodes[0] for one in left] + [one.node for one in self.discs if one.node not in speeds]
        if apart:
            raise InputError(
                f"torsion.file: node {apart[0]} is apart or in a loop, expected one line without loops"
            )
        return speeds, before


def _way(node: int, before: Mapping[int, tuple[Link, int]]) -> Iterator[Link]:
    """Yield the links from a node to the propeller."""
    while node in before:
        link, node = before[node]
        yield link
