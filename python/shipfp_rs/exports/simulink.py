"""A MATLAB script that builds a fingerprint's ship in Simulink, and a MAT file with its parameters."""

from __future__ import annotations

from pathlib import Path

from scipy.io import savemat

from shipfp_rs.errors import InputError
from shipfp_rs.exports.blocks import Block
from shipfp_rs.exports.drive import Drive
from shipfp_rs.support.files import replacing, write_text_atomically

MATH, CONTINUOUS, PORTS = "simulink/Math Operations", "simulink/Continuous", "simulink/Ports & Subsystems"
LIBRARY: dict[str, tuple[str, dict[str, str]]] = {
    "input": (f"{PORTS}/In1", {}),
    "gain": (f"{MATH}/Gain", {"Gain": "{value}"}),
    "bias": (f"{MATH}/Bias", {"Bias": "{value}"}),
    "sum": (f"{MATH}/Sum", {"Inputs": "{value}"}),
    "product": (f"{MATH}/Product", {"Inputs": "2"}),
    "power": ("simulink/User-Defined Functions/Fcn", {"Expr": "abs(u)^({value}-1)*u"}),
    "clip": ("simulink/Discontinuities/Saturation", {"UpperLimit": "{value}", "LowerLimit": "-({value})"}),
    "limit": ("simulink/Discontinuities/Saturation", {"UpperLimit": "{value}", "LowerLimit": "-inf"}),
    "rate": (
        "simulink/Discontinuities/Rate Limiter",
        {"RisingSlewLimit": "{value}", "FallingSlewLimit": "-({value})"},
    ),
    "delay": (f"{CONTINUOUS}/Transport Delay", {"DelayTime": "{value}"}),
    "lag": (f"{CONTINUOUS}/Transfer Fcn", {"Numerator": "1", "Denominator": "[{value} 1]"}),
    "integrator": (f"{CONTINUOUS}/Integrator", {"InitialCondition": "0"}),
    "output": (f"{PORTS}/Out1", {}),
}
"""Simulink library block and its dialog parameters, by kind of block."""


def write_simulink(drive: Drive, path: Path) -> Path:
    """Write the script and a MAT file of the same name; `InputError` for a name that MATLAB does not accept."""
    if not path.stem.isidentifier() or not path.stem.isascii():
        raise InputError(
            f"{path}: found the name {path.stem!r}, expected letters, digits and _, as MATLAB's scripts have"
        )
    blocks = [*drive.blocks]
    for block, signal in drive.outputs.items():
        scaled = Block(f"{signal} scaled", "gain", (f"{signal} ratio",), f"{signal}_0")
        blocks += [
            Block(f"{signal} ratio", "bias", (block,), "1"),
            scaled,
            Block(signal, "output", (scaled.name,)),
        ]
    lines = [
        f"% {drive.name}: the ship of a fingerprint, from rest at its operating point. Parameters are in {path.stem}.mat.",
        f"% Inputs {', '.join(drive.inputs.values())}; outputs {', '.join(drive.outputs.values())}.",
    ]
    if drive.undetermined:
        lines.append(f"% Determined only together with others: {', '.join(drive.undetermined)}.")
    if "M_soft" in drive.parameters:
        lines.append("% The torque limit is sharp here; in the fingerprint its corner is rounded by M_soft.")
    model = f"{path.stem}_model"
    lines += [
        f"load('{path.stem}.mat');",
        f"model = '{model}';",
        "new_system(model);",
        "open_system(model);",
        *(_added(block) for block in blocks),
        *(
            f"add_line(model, '{source}/1', '{block.name}/{port}', 'autorouting', 'on');"
            for block in blocks
            for port, source in enumerate(block.inputs, 1)
        ),
        "Simulink.BlockDiagram.arrangeSystem(model);",
    ]
    with replacing(path.with_suffix(".mat")) as temporary, temporary.open("wb") as file:
        savemat(file, drive.parameters)
    return write_text_atomically(path, "\n".join(lines) + "\n")


def _added(block: Block) -> str:
    library, dialog = LIBRARY[block.kind]
    value = block.value.split(",")[0]
    words = "".join(f", '{name}', '{text.format(value=value)}'" for name, text in dialog.items())
    return f"add_block('{library}', [model '/{block.name}']{words});"
