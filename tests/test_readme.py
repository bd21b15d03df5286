"""The README's Python runs as printed, and its figures are those of the command it names."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("block", re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL))
def test_python_of_the_readme_runs(block, capsys):
    exec(compile(block, "README.md", "exec"), {})
    assert "tau_n=" in capsys.readouterr().out


def test_the_table_of_full_scale_results_is_what_the_command_prints(fullscale):
    rows = {(row.case, row.way): row for row in fullscale.rows if row.case in ("ii", "ii, ten points")}
    printed = [
        f"{rows[key].fit['dn']:.1f} / {rows[key].fit['dM']:.1f}"
        for key in (("ii", "printed"), ("ii", "thesis"), ("ii", "ours"), ("ii, ten points", "ours"))
    ]
    for figures in printed:
        assert figures in README
    assert (
        f"{rows['ii', 'ours'].parameters['p']:.2f} | {rows['ii', 'ours'].parameters['tau_prop']:.2f}"
        in README
    )
