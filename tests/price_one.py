"""One frozen draw in a process of its own; see `tests.price`."""

from __future__ import annotations

import json
import sys
import tempfile
import warnings
from pathlib import Path

import shipfp_rs as fp
from shipfp_rs.experiments.parquet import read_experiments, write_experiments
from tests.families import recording
from tests.families.draw import draw
from tests.families.one import identified


def freeze(family: str, seed: int, signals: Path) -> None:
    """Write the experiments of a draw's raw log, and its truth beside them."""
    drawn = draw(family, seed, load=False)
    signals.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        trial, log = recording.write(drawn, Path(folder))
        experiments = fp.process(trial)
    known = drawn.truth()
    known["parameters"]["T_M"] = log.facts["T_M"]
    signals.with_suffix(".json").write_text(json.dumps(known), encoding="utf-8")
    write_experiments(signals, experiments)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    family, seed, signals, file = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]), Path(sys.argv[4])
    if not signals.is_file():
        freeze(family, seed, signals)
    result = identified(read_experiments(signals), None)
    file.write_text(json.dumps(result), encoding="utf-8")
