"""Exports of a fingerprint to other tools: FMU, Simulink, python-control, and governor cards for power-system tools."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal

from shipfp_rs.exports.cards import degov, ggov1
from shipfp_rs.exports.drive import Drive
from shipfp_rs.exports.fmu import write_fmu
from shipfp_rs.exports.simulink import write_simulink
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.files import ending_in, write_text_atomically

Target = Literal["fmu", "simulink", "control", "degov", "ggov1"]
SUFFIXES: Mapping[str, str] = {
    "fmu": ".fmu",
    "simulink": ".m",
    "control": ".py",
    "degov": ".dyr",
    "ggov1": ".dyr",
}

CONTROL = '''"""{name}, linearised about the operating point: set point and outputs are relative deviations."""

import control

A = {A}
B = {B}
C = {C}
D = {D}
ship = control.ss(A, B, C, D, inputs=["dn_set"], outputs={outputs}, name={name!r})
'''


def files_of(to: Target, out: str | Path | None) -> list[Path]:
    """Return the files of an export; the first has the given or the default name."""
    suffix = SUFFIXES[to]
    path = ending_in(out or f"{to if suffix == '.dyr' else 'ship'}{suffix}", suffix)
    return [path, path.with_suffix(".mat")] if to == "simulink" else [path]


@checked
def export(fingerprint: Fingerprint | str | Path, to: Target, out: str | Path | None = None) -> Path:
    """Write a fingerprint's ship, or its governor, for another tool.

    Parameters
    ----------
    fingerprint
        A fingerprint, or the path of a `fingerprint.json`.
    to
        "fmu": a co-simulation FMU (FMI 2.0) of the nonlinear ship, with set point [rpm] and measured load [Nm] as inputs,
        speed and torque in the units of the measured signals as outputs, and the parameters. The export needs the extra
        `fmu`, and the FMU needs CPython 3.10 or later where it runs.
        "simulink": a MATLAB script that builds the same ship, and a MAT file beside it with the parameters.
        "control": a Python script with the linearised ship as a python-control state space; see `Fingerprint.to_ss`.
        "degov", "ggov1": the governor as a card for power-system tools, in the format of PSS/E's .dyr files.
    out
        File to write; None: ship.fmu, ship.m, ship.py, degov.dyr or ggov1.dyr in the current folder.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If the fingerprint lacks a value that the target needs, or has an element that the target can't express.

    Notes
    -----
    FMU and Simulink model have the equations of `Fingerprint.simulate`, without the sensors' delays. They start from
    rest at the operating point.

    Examples
    --------
    >>> export("fingerprint.json", "ggov1")  # doctest: +SKIP
    PosixPath('ggov1.dyr')
    """
    found = fingerprint if isinstance(fingerprint, Fingerprint) else Fingerprint.load(fingerprint)
    path = files_of(to, out)[0]
    if to in ("fmu", "simulink"):
        write: Callable[[Drive, Path], Path] = write_fmu if to == "fmu" else write_simulink
        return write(Drive.of(found), path)
    if to == "control":
        space, name = found.linearised()
        parts = {part: getattr(space, part).tolist() for part in "ACD"}
        columns = {"B": space.B[:, None].tolist(), "D": [[one] for one in parts.pop("D")]}
        text = CONTROL.format(name=name, outputs=list(space.outputs), **parts, **columns)
    else:
        text = (degov if to == "degov" else ggov1)(found)
    return write_text_atomically(path, text)


__all__ = ["Target", "export", "files_of"]
