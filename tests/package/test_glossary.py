"""The glossary: one table in the package, the same on its page, in units that structures use."""

from pathlib import Path

import pytest

from shipfp_rs import Structure
from shipfp_rs.experiments.experiment import UNITS
from shipfp_rs.structures import glossary, names
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.structures.ties import COMBINATIONS

PAGE = Path(__file__).parents[2] / "docs" / "background" / "glossary.md"
STRUCTURES = {
    "linear": Structure.linear(
        torque="gauge", free_exponent=True, dead_time_loop=True, dead_time_set_point=True
    ),
    "ship": Structure.ship([*ELEMENTS], torque="gauge", products=False),
}


def written(terms: tuple[glossary.Term, ...]) -> str:
    rows = [
        f"| `{t.symbol}` | {t.meaning} | {f'`{t.formula}`' if t.formula else ''} | {t.unit} | {t.elsewhere} |"
        for t in terms
    ]
    return "\n".join(["| symbol | meaning | formula | unit | elsewhere |", "|---|---|---|---|---|", *rows])


@pytest.mark.parametrize("group", ["SIGNALS", "LINEAR", "COMBINATIONS", "OBJECTS"])
def test_the_page_shows_the_table(group: str) -> None:
    table = written(getattr(glossary, group))
    assert table in PAGE.read_text(encoding="utf-8"), f"in {PAGE.name} expected:\n{table}"


def test_every_symbol_stands_once() -> None:
    groups = (glossary.SIGNALS, glossary.LINEAR, glossary.COMBINATIONS, glossary.OBJECTS)
    assert len(glossary.GLOSSARY) == sum(map(len, groups))


@pytest.mark.parametrize("name", STRUCTURES)
def test_every_parameter_is_explained_in_its_unit(name: str) -> None:
    for parameter in STRUCTURES[name].parameters:
        assert parameter.meaning, parameter.name
        assert glossary.GLOSSARY[parameter.name].unit == parameter.unit, parameter.name


def test_signals_are_explained_in_their_units() -> None:
    assert all(glossary.GLOSSARY[name].unit == unit for name, unit in UNITS.items())


def test_every_parameter_and_combination_has_a_plain_name() -> None:
    declared = {parameter.name for structure in STRUCTURES.values() for parameter in structure.parameters}
    known = {term.symbol for term in (*glossary.LINEAR, *glossary.COMBINATIONS)}
    assert known <= set(names.NAMES)
    for symbol in declared | set(COMBINATIONS):
        assert names.plain_name(symbol), symbol
    assert names.plain_name("tau_n (fast)") == "inertia time constant (fast)"


def test_combinations_are_explained_in_their_units() -> None:
    rows = {term.symbol: term.unit for term in glossary.COMBINATIONS}
    assert rows == {name: unit for name, (unit, _) in COMBINATIONS.items() if name not in ("vK_p", "vK_i")}
