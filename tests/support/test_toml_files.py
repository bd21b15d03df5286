"""Mistakes in nested tables, lists of tables and tables under names of the user's own."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import pytest
from pydantic import ConfigDict, Field

from shipfp_rs.errors import InputError
from shipfp_rs.support.toml import Section, validated


class Sail(Section):
    area_m2: float


class Mast(Section):
    height_m: float = Field(gt=0.0)
    shrouds: int = 4
    wood: Literal["oak", "pine"] = "oak"
    sails: Annotated[tuple[Sail, ...], Field(strict=False)] = ()


class Rig(Section):
    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Mast]

    main: Mast


class Ship(Section):
    rig: Rig
    flags: dict[str, Sail] = Field(default_factory=dict)


MAIN: dict[str, Any] = {"height_m": 12.0}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"rig": {"main": {"hight_m": 12.0}}}, "rig.main.hight_m: found an unknown key, did you mean 'height_m'?"),
        ({"rig": {"main": {"xyz": 1, **MAIN}}}, "rig.main.xyz: found an unknown key, expected one of h"),
        ({"rig": {"mizzen": {"hight_m": 1.0, **MAIN}, "main": MAIN}}, "rig.mizzen.hight_m: found an unknown key"),
        ({"rig": {"mian": {"hight_m": 1.0}, "main": MAIN}},
         "rig.mian: found a table with an unknown key, 'hight_m'; did you mean 'main'?"),
        ({"rig": {"main": {"sails": [{"area_m": 9.0}], **MAIN}}}, "rig.main.sails.0.area_m: found an unknown key"),
        ({"rig": {"main": MAIN}, "flags": {"red": {"aera_m2": 1.0}}}, "flags.red.aera_m2: found an unknown key"),
        ({"rig": {"main": {**MAIN, "wood": "steel"}}}, "rig.main.wood: found 'steel', expected 'oak' or 'pine'"),
        ({"rig": {"main": 3}}, "rig.main: found 3, expected a table"),
        ({"rog": {}, "rig": {"main": MAIN}}, "rog: found an unknown key, did you mean 'rig'?"),
        ({"rig": {"main": {"height_m": True}}}, "rig.main.height_m: found True, expected a valid number"),
        ({"rig": {"main": {"height_m": "12.0"}}}, "rig.main.height_m: found '12.0', expected a valid number"),
        ({"rig": {"main": {"height_m": float("nan")}}}, "rig.main.height_m: found nan, expected a finite number"),
        ({"rig": {"main": {"height_m": -1.0}}}, "rig.main.height_m: found -1.0, expected greater than 0"),
        ({"rig": {"main": {**MAIN, "shrouds": 2.5}}}, "rig.main.shrouds: found 2.5, expected a valid integer"),
        ({"rig": {"main": {**MAIN, "wood": 3}}}, "rig.main.wood: found 3, expected 'oak' or 'pine'"),
        ({"rig": {"main": {**MAIN, "sails": "x" * 200}}}, f"rig.main.sails: found '{'x' * 56}..., expected a list"),
        ({"rig": {}}, "rig.main: found nothing, expected this key to be given"),
    ],
)  # fmt: skip
def test_the_mistake_is_named_with_its_place(content: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        validated(content, Ship, "ship.toml")
    assert str(caught.value).startswith(f"ship.toml: {message}")
