"""A damaged log is refused, repaired or masked, and which of its samples: never used in silence."""

from collections import Counter
from pathlib import Path

import pytest

from tests.log_damage import CLASSES, UNTOLD, outcome

FOLLOWED = {
    "stuck sensor", "clipped torque", "NaN stretch", "dropout to zero", "single spikes", "mains hum on the set point",
}  # fmt: skip
"""Classes that test_processing.py follows sample by sample in every check; here they are drawn in the study alone."""
TELLABLE = [kind for kind in CLASSES if kind not in {*UNTOLD, *FOLLOWED}]
GOOD = {"refused", "told"}


@pytest.mark.parametrize("kind", TELLABLE)
def test_damage_is_never_silent(kind: str, tmp_path: Path) -> None:
    assert outcome(kind, 1, tmp_path) in GOOD


@pytest.mark.study
def test_study_of_log_damage(tmp_path: Path) -> None:
    seeds = 50
    print(f"\n{'class of damage':34s} {'refused':>8s} {'told':>6s} {'not told':>9s}   of {seeds} seeds")
    missed = {}
    for kind in CLASSES:
        found = Counter(outcome(kind, seed, tmp_path) for seed in range(100, 100 + seeds))
        bad = {what: count for what, count in found.items() if what not in GOOD}
        note = "nothing in one log tells it" if kind in UNTOLD else ""
        print(f"{kind:34s} {found['refused']:8d} {found['told']:6d} {sum(bad.values()):9d}   {note}")
        if bad and kind not in UNTOLD:
            missed[kind] = bad
    assert not missed, missed
