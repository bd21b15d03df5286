"""The report is one safe, self-contained page that leads with the verdict."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import time
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from shipfp_rs import plot
from shipfp_rs.errors import SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint, Identifiability
from shipfp_rs.identification.identify import identify
from shipfp_rs.plot import style
from shipfp_rs.report import render, write_report
from shipfp_rs.report.pictures import thin
from shipfp_rs.structures.structure import Structure
from tests.identification.parity import Case, simulated
from tests.launch import echo

NASTY = "<script>alert('&')</script>"
PEAK = 1_234_567


def record(name: str, seconds: float, **facts) -> Experiment:
    """Return a slow sine at 100 Hz, its torque masked for two seconds; a long one has a peak of one sample."""
    time = np.arange(0.0, seconds, 0.01)
    random = np.random.default_rng(3)
    set_point = 1183.8 + 76.0 * np.sin(0.3 * time)
    speed = set_point + random.normal(0.0, 5.0, time.size)
    torque = 1.45 * speed + random.normal(0.0, 30.0, time.size)
    speed[PEAK : PEAK + 1] = 1900.0
    torque[1000:1200] = np.nan
    signals = {"n_set": set_point, "n_e": speed, "M_g": torque}
    return Experiment(name, 100.0, signals, {"n_set": 1183.8, "n_e": 1183.8, "M_g": 1725.0}, **facts)


def repair(kind: str, channel: str, method: str, spans: list[list[int]], excluded: bool = True) -> dict:
    about = {"kind": kind, "channel": channel, "method": method}
    return {**about, "count": len(spans), "spans": spans, "excluded": excluded}


@pytest.fixture(scope="module")
def experiments() -> list[Experiment]:
    provenance = {
        "log": NASTY,
        "speed": {"train": "PTM_4", "reflectors": {"fractions": [0.2535, 0.2465]}},
        "faults": [repair("C", NASTY, "masked", [[10 * k, 10 * k + 3] for k in range(120)])],
    }
    return [record(f"{NASTY} {index}", 600.0, kind=NASTY, provenance=provenance) for index in range(2)]


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
    simulated = [echo(one) for one in experiments]
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
        if tag not in ("meta", "col"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.tags.append(tag)
        self.identifiers += [value for name, value in attributes if name == "id"]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def row_of(name: str, page: str) -> str:
    return re.search(rf'<tr><th scope="row"><code>{name}</code>.*?</tr>', page).group()


def outline(page: str) -> Outline:
    parser = Outline()
    parser.feed(page)
    parser.close()
    return parser


def test_whatever_the_user_named_is_escaped(page) -> None:
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert" in page
    charts, own = 2, 3
    assert outline(page).tags.count("script") == charts + own


def test_only_the_page_s_own_scripts_may_run_and_nothing_may_be_fetched(page) -> None:
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page).group(1)
    assert "default-src 'none'" in policy
    allowed = re.findall(r"'sha256-([^']*)'", policy)
    scripts = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    assert [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in scripts] == allowed


def test_the_page_needs_nothing_from_elsewhere(page) -> None:
    assert not re.search(r"https?:|[\"'(]//[a-z]|@import|<link|<img", page)
    # Links lead within the page, or save what it holds.
    addresses = re.findall(r'(?:href|src)="(#|data:text/csv;base64,|[^"]*)', page)
    assert set(addresses) == {"#", "data:text/csv;base64,"}


def test_the_page_is_well_formed_and_no_identifier_stands_twice(page) -> None:
    found = outline(page)
    assert not found.open
    assert len(found.identifiers) == len(set(found.identifiers))
    references = set(re.findall(r'href="#([^"]+)|url\(#([^)]+)\)', page))
    assert {a or b for a, b in references} <= set(found.identifiers)


def test_the_verdict_s_first_sentence_comes_first(page) -> None:
    answer = re.search(r'<p class="answer[^"]*">(.*?)</p>', page)
    assert answer.group(1).startswith("Known: tau_n = 1.17 s.")
    assert answer.start() < page.index("<table") < page.index("<h2")


def test_figures_are_rounded_to_two_digits_of_their_uncertainty(page) -> None:
    row = row_of("tau_n", page)
    assert re.findall(r">([^<>]+)</td>", row) == [
        "inertia time constant",
        "1.171",
        "0.023",
        "1.125 to 1.217",
        "s",
        "1.300 ✗",
        "2π I n_s0 / M_s0",
        "estimated",
    ]
    assert re.search('class="number bad"[^>]*>1.300', row)  # the interval misses the truth


def test_what_can_not_be_told_says_why_in_its_row(page) -> None:
    row = row_of("v", page)
    assert "not identifiable" in row
    assert "only known together with" in row


def test_repairs_of_the_data_are_listed(page) -> None:
    row = re.search(r'<tr><th scope="row">torque spikes \(C\)</th>.*?</tr>', page).group()
    assert re.findall(r">([^<>]+)</td>", row)[1:] == ["cut: masked", "120", "12", "360"]
    assert "0–2, 10–12" in page
    assert "and 20 more" in page
    assert "fractions: 0.2535, 0.2465" in page


def test_masked_samples_are_counted(page) -> None:
    assert "M_g masked in 0.33 %" in page


def test_an_interval_that_begins_on_a_bound_has_one_end(fingerprint) -> None:
    on_bounds = {
        "T_d": Estimate(0.0, None, (0.0, 0.0213), "s", "at_bound", "on its lower bound 0"),
        "K_p": Estimate(50.0, None, (43.2, 50.0), "-", "at_bound", "on its upper bound 50"),
        "g": Estimate(1.0, status="at_bound", reason="pressed against its upper bound 1"),
    }
    page = render(replace(fingerprint, parameters=on_bounds), [])
    told = [re.findall(r"<td[^>]*>([^<>]*)</td>", row_of(name, page)) for name in on_bounds]
    assert [cells[1] for cells in told] == ["at most 0.0213", "50", "1"]
    assert [cells[3] for cells in told] == ["may be zero", "≥ 43.2", ""]


def test_a_fit_without_correlation_tests_says_what_its_model_misses(fingerprint) -> None:
    fit = {"dn": {"nrmse_pct": 97.5}, "overall": {"deviance": 483.0}}
    adequate = {"stands": True, "misses_pct": {"dn": 0.0, "dM": 0.088}}
    page = render(replace(fingerprint, fit=fit, residuals={}, adequate=adequate), [])
    assert "only for given structures" in page
    assert "Missed share of the drive train&#39;s response: 0 % of the speed, 0.088 % of the torque." in page


def recorded(experiment: Experiment) -> Experiment:
    """Return an experiment cut from 100 to 700 s of a log at 1 kHz, with some hum taken out and two masked spikes."""
    clock = {"rate_hz": 1000.0, "start_s": 0.0, "samples": 1_000_000, "rows": [100_000, 700_000]}
    provenance = {
        "log": "log.parquet",
        "window_s": [100.0, 700.0],
        "recorded": {
            "U_set": {**clock, "signal": "n_set"},
            "U_M": {**clock, "signal": "M_g"},
            "PTM_1": {**clock, "signal": ""},
        },
        "faults": [
            repair("D2", "U_set", "50 Hz taken out", [[100_500, 100_600]], excluded=False),
            repair("D3", "U_set", "kept: no chirp", [[100_000, 700_000]], excluded=False),
            repair("C", "U_M", "masked", [[120_000, 120_010], [300_000, 300_020]]),
            repair("A", "PTM_1", "second crossings removed", [[200_000, 200_500]]),
        ],
    }
    return replace(experiment, name="S1", provenance=provenance)


def test_every_recorded_sample_has_one_fate(fingerprint, experiments) -> None:
    page = render(fingerprint, [recorded(experiments[0])])
    head = re.findall(r'<th scope="col"[^>]*>([^<]*)</th>', page[page.index("fate of the recorded") :])[2:8]
    assert head == ["recorded", "kept", "repaired", "cut", "another sensor used", "outside windows"]
    fates = {
        name: [int(key) for key in re.findall(r'data-key="(\d+)"', row_of(name, page))]
        for name in ("U_set", "U_M", "PTM_1")
    }
    assert fates == {
        "U_set": [1_000_000, 599_900, 100, 0, 0, 400_000],
        "U_M": [1_000_000, 599_970, 0, 30, 0, 400_000],
        "PTM_1": [1_000_000, 0, 0, 0, 600_000, 400_000],
    }


def test_figures_of_the_account_have_units_and_no_row_is_empty(fingerprint, experiments) -> None:
    one = experiments[0]
    page = render(
        fingerprint,
        [replace(one, provenance={**one.provenance, "gauge_accuracy": {}, "normalise": "global"})],
    )
    assert "operating point n_set = 1183.8 rpm, n_e = 1183.8 rpm, M_g = 1725 Nm." in page
    assert "normalise" in page
    assert "gauge_accuracy" not in page
    told = {"vK_i/tau_n": Estimate(2.0, 0.1, (1.8, 2.2), unit="1/s2")}
    axes = plot.intervals(replace(fingerprint, derived=told))
    assert "vK_i/tau_n = 2 1/s²" in [label.get_text() for label in axes.get_yticklabels()]


def charted(page: str) -> list[dict]:
    return [json.loads(text) for text in re.findall(r'<script type="application/json">(.*?)</script>', page)]


def unpacked(series: dict) -> np.ndarray:
    steps = np.frombuffer(base64.b64decode(series["data"]), dtype="<u2").astype(np.float64)
    steps[steps == 65535] = np.nan
    return series["low"] + steps * (series["high"] - series["low"]) / 65534


def test_faults_are_marked_at_their_time_in_the_panel_of_their_signal(fingerprint, experiments) -> None:
    (chart,) = charted(render(fingerprint, [recorded(experiments[0])]))
    speed, torque = chart["panels"]
    assert [mark["spans"] for mark in speed["marks"]] == [[[0.5, 0.6]]]
    assert [mark["spans"] for mark in torque["marks"]] == [[[20.0, 20.01], [200.0, 200.02]]]
    assert [mark["cut"] for mark in speed["marks"] + torque["marks"]] == [False, True]


def test_times_are_those_of_the_log(fingerprint, experiments) -> None:
    late = replace(experiments[0], provenance={**experiments[0].provenance, "window_s": [60.0, 300.0]})
    page = render(fingerprint, [late], simulated=[echo(late)])
    (chart,) = charted(page)
    assert chart["start"] == 60.0
    seen = re.search(r", (\d+) to (\d+) s: measurement", page)
    assert float(seen[1]) >= 60.0
    assert late.window(5.0, 10.0).start_s == pytest.approx(65.0)


def test_another_fit_has_its_own_section(fingerprint) -> None:
    page = render(fingerprint, [], also=("Published data", "Sine fits.", fingerprint, []))
    section = page[page.index('id="also"') :]
    assert "Published data</h2>" in section
    assert "<code>tau_n</code>" in section


def test_a_legend_is_as_wide_as_its_picture() -> None:
    (ax,) = style.panels_of(None, 1)
    for place in range(8):
        ax.plot([0, 1], label=f"a window of a long name, {place}")
    style.dress(ax, "speed [rpm]")
    ax.figure.canvas.draw()
    assert ax.get_legend().get_window_extent().x0 >= 0.0


def test_a_chart_of_a_short_record_holds_every_sample_and_its_masks(page, experiments) -> None:
    speed, residual, torque, _ = charted(page)[0]["panels"]
    measured = experiments[0].signals["n_e"]
    assert [series["label"] for series in speed["series"]] == ["set point n_set", "speed n_e", "model of n_e"]
    np.testing.assert_allclose(unpacked(speed["series"][1]), measured, atol=np.ptp(measured) / 65534)
    assert np.isnan(unpacked(torque["series"][0])[1000:1200]).all()
    assert torque["marks"][0]["spans"] == [[10.0, 12.0]]
    assert "minus the model" in residual["series"][0]["label"]


@pytest.fixture(scope="module")
def long() -> Experiment:
    return record("eight hours", 8 * 3600.0)


def test_eight_hours_with_many_faults_fit_into_ten_megabytes(fingerprint, long) -> None:
    assert long.duration == 8 * 3600
    samples = 57_600_000
    clock = {"signal": "M_g", "rate_hz": 2000.0, "start_s": 0.0, "samples": samples, "rows": [0, samples]}
    spikes = [[1400 * index, 1400 * index + 9] for index in range(5000)]
    account = {
        "log": "log",
        "window_s": [0.0, 3600.0],
        "recorded": {"U_M": clock},
        "faults": [repair("C", "U_M", "masked", spikes)],
    }
    hours = [
        replace(long.window(3600.0 * hour, 3600.0 * (hour + 1), name=f"hour {hour}"), provenance=account)
        for hour in range(8)
    ]
    models = [echo(hour) for hour in hours]
    page = render(fingerprint, hours, simulated=models)
    print(f"8 h, {len(long):,} samples of 3 signals, 2 models: {len(page.encode()) / 1e6:.1f} MB")
    assert len(page.encode()) < 10e6
    assert len(charted(page)) == 8


def test_no_peak_is_lost_in_eight_hours(fingerprint, long) -> None:
    (chart,) = charted(render(fingerprint, [long]))
    speed = unpacked(chart["panels"][0]["series"][1])
    assert speed.size < 0.5 * len(long)
    assert speed.max() == pytest.approx(1900.0)
    assert int(speed.argmax()) // 2 == PEAK // round(chart["step"] * long.rate_hz)


def test_thinning_ten_million_samples_takes_no_longer_than_a_few_sorts_of_a_tenth() -> None:
    samples = np.random.default_rng(4).normal(size=10_000_000)
    began = time.thread_time()
    thinned = thin(samples, 50)
    middle = time.thread_time()
    np.sort(samples[:1_000_000], kind="heapsort")
    assert middle - began < 4.0 * (time.thread_time() - middle)
    assert (thinned.min(), thinned.max()) == (samples.min(), samples.max())


def test_a_fingerprint_without_experiments_or_verdict_still_makes_a_page(tmp_path, fingerprint) -> None:
    bare = replace(
        fingerprint, verdict=(), parameters={"v": Estimate(None, status="unidentifiable")}, derived={}
    )
    path = write_report(tmp_path / "report.html", bare, [])
    assert "No verdict" in path.read_text(encoding="utf-8")
    assert "svg" not in outline(path.read_text(encoding="utf-8")).tags


def test_a_ship_that_runs_away_has_a_report_without_its_signals(tmp_path, monkeypatch, caplog):
    _, record = simulated(Case(seconds=60.0))
    structure = Structure.ship([], torque="gauge", products=True)
    found = identify(record, structure, intervals="symmetric")

    def runs_away(*_):
        raise SimulationError("simulation diverged at sample 4")

    monkeypatch.setattr(Fingerprint, "predict", runs_away)
    page = found.report(tmp_path / "report.html").read_text(encoding="utf-8")
    assert "no simulation in the report: simulation diverged at sample 4" in caplog.text
    assert "tau_prop" in page
