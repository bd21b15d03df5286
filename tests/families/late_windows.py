"""One ship answered from windows that begin later and later in the excitation: whether the answers hold each other."""

from __future__ import annotations

from itertools import permutations

from tests.families.score import is_known

LATE_S = (0.0, 1.3, 3.5, 7.1)
"""When the windows begin, after the excitation does [s]."""


def apart(answers) -> list[str]:
    """Return the parameters of which one answer's value is outside another's interval; both must call it known."""
    names = dict.fromkeys(name for answer in answers for name in answer["parameters"])
    return [name for name in names if any(_outside(name, *pair) for pair in permutations(answers, 2))]


def _outside(name, one, other):
    rows = [answer["parameters"].get(name, {}) for answer in (one, other)]
    if not all(map(is_known, rows)):
        return False
    low, high = rows[1]["ci95"]
    return not low <= rows[0]["value"] <= high


def agreement(results) -> str:
    """Return a line for each ship, and on how many all answers lie within each other's intervals."""
    ships: dict[str, list] = {}
    for one in results:
        ships.setdefault(f"{one['family']} {one['seed']}", []).append(one["answer"])
    lines, agreed = [], 0
    for ship, answers in ships.items():
        missing = sum(answer is None for answer in answers)
        names = [] if missing else apart(answers)
        agreed += not missing and not names
        told = f"{missing} of {len(answers)} windows without an answer" if missing else ", ".join(names)
        lines.append(f"{ship}: {told or 'all agree'}")
    lines.append(f"all windows lie within each other's intervals: {agreed} of {len(ships)} ships")
    return "\n".join(lines)
