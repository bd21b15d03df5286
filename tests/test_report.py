"""The report is one safe, self-contained page that leads with the verdict."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from shipfp_rs.experiment import Experiment
from shipfp_rs.fingerprint import Estimate, Fingerprint, Identifiability
from shipfp_rs.report import render, write_report

NASTY = "<script>alert('&')</script>"


@pytest.fixture(scope="module")
def experiments() -> list[Experiment]:
    time = np.arange(0.0, 600.0, 0.01)
    speed = 1183.8 + 76.0 * np.sin(0.3 * time) + np.random.default_rng(0).normal(0.0, 5.0, time.size)
    torque = 1.45 * speed
    torque[1000:1200] = np.nan
    return [
        Experiment(
            name=f"{NASTY} {index}",
            rate_hz=100.0,
            signals={"n_set": 1183.8 + 76.0 * np.sin(0.3 * time), "n_e": speed, "M_g": torque},
            operating_point={"n_set": 1183.8, "n_e": 1183.8, "M_g": 1725.0},
            kind=NASTY,
            provenance={
                "log": NASTY,
                "speed": {"train": "PTM_4", "reflectors": {"fractions": [0.2535, 0.2465]}},
                "repairs": [
                    {
                        "kind": "C",
                        "channel": NASTY,
                        "method": "masked",
                        "count": 120,
                        "spans": [[10 * k, 10 * k + 3] for k in range(120)],
                    }
                ],
            },
        )
        for index in range(2)
    ]


@pytest.fixture(scope="module")
def fingerprint(experiments) -> Fingerprint:
    return Fingerprint(
        parameters={
            "tau_n": Estimate(1.1712, 0.0234, (1.1253, 1.2171), "s"),
            "v": Estimate(None, status="unidentifiable", reason=f"only known together with {NASTY}"),
            "p": Estimate(2.0, status="fixed", reason="given"),
        },
        derived={"vK_p/tau_n": Estimate(9.5, 0.4, (8.7, 10.3), "1/s")},
        identifiability=Identifiability(
            1, 2, np.inf, ({"combination": f"v +1 %, {NASTY} -1 %", "direction": {}},)
        ),
        fit={"dn": {"nrmse_pct": 98.761}, "overall": {"mse": 1e-4}},
        structure={"name": NASTY},
        vessel=NASTY,
        data=({"name": NASTY, "fit": {"dn": {"nrmse_pct": 98.761}}},),
        settings={"message": NASTY},
        seed=7,
        versions={"shipfp_rs": "0.1.0"},
        verdict=(f"Known: tau_n = 1.17 s. {NASTY}",),
    )


@pytest.fixture(scope="module")
def page(fingerprint, experiments) -> str:
    simulated = [{"n_e": e.normalised("n_set"), "M_g": e.normalised("n_set")} for e in experiments]
    return render(fingerprint, experiments, simulated=simulated, truth={"tau_n": 1.3, "p": 2.0}, title=NASTY)


class Outline(HTMLParser):
    """Collects tags, attributes and identifiers, and checks that tags close in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.identifiers: list[str] = []

    def handle_starttag(self, tag, attributes):
        self.handle_startendtag(tag, attributes)
        if tag != "meta":
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.tags.append(tag)
        self.identifiers += [value for name, value in attributes if name == "id"]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def outline(page: str) -> Outline:
    parser = Outline()
    parser.feed(page)
    parser.close()
    return parser


def test_whatever_the_user_named_is_escaped(page) -> None:
    assert "<script" not in page
    assert "&lt;script&gt;" in page
    assert "script" not in outline(page).tags


def test_the_page_needs_nothing_from_elsewhere(page) -> None:
    assert not re.search(r"https?:|//[a-z]|@import|<link|<img", page)
    assert set(re.findall(r'(?:href|src)="(.)', page)) == {"#"}


def test_the_page_is_well_formed_and_no_identifier_stands_twice(page) -> None:
    found = outline(page)
    assert not found.open
    assert len(found.identifiers) == len(set(found.identifiers))
    references = set(re.findall(r'href="#([^"]+)|url\(#([^)]+)\)', page))
    assert {a or b for a, b in references} <= set(found.identifiers)


def test_the_verdict_comes_before_any_table(page) -> None:
    assert page.index("Known: tau_n") < page.index("<table")


def test_figures_are_rounded_to_two_digits_of_their_uncertainty(page) -> None:
    row = re.search(r"<tr><td><code>tau_n</code>.*?</tr>", page).group()
    assert re.findall(r">([^<>]+)</td>", row)[:5] == ["1.171", "0.023", "1.125 … 1.217", "s", "1.300"]
    assert 'class="figure bad">1.300' in row  # the interval misses the truth


def test_what_can_not_be_told_says_why_in_its_row(page) -> None:
    row = re.search(r"<tr><td><code>v</code>.*?</tr>", page).group()
    assert "not identifiable" in row
    assert "only known together with" in row


def test_repairs_of_the_data_are_listed(page) -> None:
    row = re.search(r"<tr><td>torque spikes \(C\)</td>.*?</tr>", page).group()
    assert re.findall(r">([^<>]+)</td>", row)[1:] == ["masked", "120", "360"]
    assert "0–2, 10–12" in page
    assert "and 20 more" in page
    assert "fractions: 0.2535, 0.2465" in page


def test_masked_samples_are_counted(page) -> None:
    assert "Masked samples: 0.33 % of M_g." in page


def test_long_signals_are_thinned_to_a_page_of_a_few_megabytes(page) -> None:
    assert len(page) < 3e6  # 2 x 60,000 samples x 4 pictures


def test_the_page_has_both_lights_and_pictures_in_its_ink(page) -> None:
    assert "prefers-color-scheme: dark" in page
    assert "currentColor" in page
    assert "#010203" not in page


def test_a_fingerprint_without_experiments_or_verdict_still_makes_a_page(tmp_path, fingerprint) -> None:
    bare = replace(
        fingerprint, verdict=(), parameters={"v": Estimate(None, status="unidentifiable")}, derived={}
    )
    path = write_report(tmp_path / "report.html", bare, [])
    assert "No verdict" in path.read_text(encoding="utf-8")
    assert "<svg" not in path.read_text(encoding="utf-8")
