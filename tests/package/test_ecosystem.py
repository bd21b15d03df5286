"""How the package sits among others: tables in and out, notebooks, logging, types, what importing it costs."""

from __future__ import annotations

import inspect
import logging
import os
import subprocess
import sys
from functools import partial

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs import plot
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from tests.report.test_report import outline

LAUNCH = fp.Vessel.load("stan-launch-804")


@pytest.fixture(scope="module")
def chirp() -> Experiment:
    """Return a virtual trial with one sample masked."""
    made = fp.simulate(LAUNCH, fp.signals.chirp(0.05, 5.0, 20.0, 13.0, rate_hz=100.0))
    signals = {name: np.array(made.signals[name]) for name in ("n_set", "n_e", "M_s")}
    signals["M_s"][7] = np.nan
    return Experiment("C11 <b>", 100.0, signals, made.operating_point, kind="chirp", provenance={"seed": 3})


@pytest.fixture(scope="module")
def response() -> FrequencyResponse:
    frequency = np.geomspace(0.01, 2.0, 9)
    model = fp.linearise(LAUNCH).frequency_response(frequency, name="S2")
    return FrequencyResponse(
        "S2",
        frequency,
        model.response,
        amplitude_std=dict.fromkeys(model.response, np.full(9, 0.02)),
        phase_std=dict.fromkeys(model.response, np.full(9, 0.03)),
    )


POLARS = """
import numpy as np, polars, shipfp_rs as fp
launch = fp.Vessel.load("stan-launch-804")
trial = fp.simulate(launch, fp.signals.steps([13.0], 1.0))
frame = polars.DataFrame(trial)  # through the Arrow stream; the facts stay behind
assert frame.columns == ["time_s", *trial.signals]
back = fp.Experiment.from_arrow(frame, operating_point=dict(trial.operating_point))
assert back.rate_hz == trial.rate_hz
assert all(np.array_equal(back.signals[name], trial.signals[name]) for name in trial.signals)
response = fp.linearise(launch).frequency_response([0.1, 1.0])
again = fp.FrequencyResponse.from_arrow(polars.DataFrame(response))
assert all(np.array_equal(again.response[name], response.response[name]) for name in response.response)
"""


class TestTables:
    def test_an_experiment_comes_back_from_each_package_as_it_went(self, chirp, tmp_path) -> None:
        xarray = pytest.importorskip("xarray")
        assert Experiment.from_xarray(chirp.to_xarray()) == chirp
        assert Experiment.from_pandas(chirp.to_pandas()) == chirp
        assert Experiment.from_arrow(chirp.to_arrow()) == chirp
        assert isinstance(chirp.to_xarray(), xarray.Dataset)

    def test_a_response_comes_back_from_each_package_as_it_went(self, response) -> None:
        assert FrequencyResponse.from_xarray(response.to_xarray()) == response
        assert FrequencyResponse.from_pandas(response.to_pandas()) == response
        assert FrequencyResponse.from_arrow(response.to_arrow()) == response

    def test_polars_takes_and_gives_both(self) -> None:
        # In a process of its own: importing polars makes system calls go on after Ctrl-C, which other tests send.
        done = subprocess.run([sys.executable, "-c", POLARS], capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")

    def test_units_go_along(self, chirp, response) -> None:
        dataset = chirp.to_xarray()
        assert [dataset[name].attrs["units"] for name in ("time_s", "n_e", "M_s")] == ["s", "rpm", "Nm"]
        assert response.to_xarray()["frequency_hz"].attrs["units"] == "Hz"
        assert chirp.to_arrow().schema.field("M_s").metadata == {b"unit": b"Nm"}

    def test_what_came_back_gives_the_same_fingerprint(self, chirp) -> None:
        structure = fp.Structure.linear(products=True)
        there = fp.identify(chirp, structure, noise="white")
        back = fp.identify(Experiment.from_pandas(chirp.to_pandas()), structure, noise="white")
        assert there.to_dict()["parameters"] == back.to_dict()["parameters"]

    @pytest.mark.parametrize(
        ("change", "line"),
        [
            (
                lambda f: f.drop(index=f.index[5]),
                "column 'time_s' steps by 0.02 s at row 4, expected 0.01000",
            ),
            (lambda f: f.iloc[::-1], "column 'time_s' does not ascend; give the time in seconds, or rate_hz"),
            (lambda f: f.assign(n_e="fast"), "column 'n_e' holds .*, expected numbers; leave it out"),
            (lambda f: f.rename(columns={"M_s": "Ms"}), "signal 'Ms' is unknown, did you mean 'M_s'"),
        ],
    )
    def test_a_frame_that_is_no_experiment_costs_one_line(self, chirp, change, line) -> None:
        frame = change(chirp.to_pandas())
        frame.attrs = {}
        with pytest.raises(fp.InputError, match=line):
            Experiment.from_pandas(frame, operating_point=dict(chirp.operating_point))

    def test_a_frame_without_an_operating_point_is_about_its_means(self, chirp) -> None:
        frame = chirp.to_pandas()
        frame.attrs = {}
        made = Experiment.from_pandas(frame)
        assert made.operating_point["n_e"] == pytest.approx(chirp["n_e"].mean())
        assert made.provenance["operating_point"] == "means of the record"

    def test_a_package_that_is_missing_is_named_with_its_command(self, chirp, monkeypatch) -> None:
        monkeypatch.setitem(sys.modules, "xarray", None)
        with pytest.raises(fp.InputError, match=r"pip install 'shipfp_rs\[xarray\]'"):
            chirp.to_xarray()


class TestNotebooks:
    def test_each_object_shows_itself_whole_and_escaped(self, chirp, response) -> None:
        fingerprint = fp.identify(chirp, fp.Structure.linear(products=True), noise="white", vessel="<script>")
        for thing, words in (
            (chirp, "C11 &lt;b&gt;"),
            (response, "S2"),
            (LAUNCH, "shaft.inertia_kg_m2"),
            (fingerprint, "&lt;script&gt;"),
        ):
            page = thing._repr_html_()
            found = outline(page)
            assert words in page
            assert not found.open
            assert set(found.tags) == {"p", "b", "table", "thead", "tbody", "tr", "th", "td"}

    def test_each_repr_is_one_short_line(self, chirp, response) -> None:
        assert repr(chirp) == "Experiment('C11 <b>', 2000 samples at 100 Hz: n_set, n_e, M_s)"
        assert repr(response) == "FrequencyResponse('S2', 9 points from 0.01 to 2 Hz: n_e, M_b)"
        assert repr(LAUNCH) == "Vessel('Stan Launch 804', 89 kW at 1800 rpm, gear 3, propeller 0.77 m)"

    def test_plot_returns_axes_and_shows_nothing(self, chirp, response, monkeypatch) -> None:
        import matplotlib as mpl

        mpl.use("agg")
        from matplotlib import pyplot
        from matplotlib.axes import Axes

        monkeypatch.setattr(pyplot, "show", lambda *_: pytest.fail("show was called"))
        for draw, panels in ((partial(plot.signals, chirp), 2), (partial(plot.bode, response), 2)):
            axes = draw()
            assert [isinstance(ax, Axes) for ax in axes] == [True] * panels
            assert list(draw(axes=axes)) == list(axes)  # drawn into those given
            pyplot.close(axes[0].figure)


class TestTabCompletion:
    def test_python_offers_public_names_and_parameters(self, chirp) -> None:
        assert set(fp.__all__) <= set(dir(fp))
        found = fp.identify(chirp, fp.Structure.linear(products=True), noise="white")
        assert {"tau_n", "g", "vK_p", "vK_i"} <= set(found._ipython_key_completions_())

    @pytest.mark.parametrize(
        ("shell", "typed", "offered"),
        [
            ("bash", "shipfp sw", "sweep"),
            ("zsh", "shipfp design --acc", "--accuracy"),
            ("fish", "shipfp sw", "sweep"),
        ],
    )
    def test_a_shell_is_offered_commands_and_options(self, shell, typed, offered) -> None:
        words = {
            "COMP_WORDS": typed,
            "COMP_CWORD": str(len(typed.split()) - 1),
            "_TYPER_COMPLETE_ARGS": typed,
            "_SHIPFP_COMPLETE": f"complete_{shell}",
            "_TYPER_COMPLETE_FISH_ACTION": "get-args",
        }
        command = [sys.executable, "-m", "shipfp_rs.cli"]
        done = subprocess.run(
            command, env={**os.environ, **words}, capture_output=True, text=True, check=False
        )
        assert offered in done.stdout


def test_the_log_is_silent_until_someone_listens(capfd, caplog) -> None:
    code = (
        "import shipfp_rs as fp; v = fp.Vessel.load('stan-launch-804'); "
        "fp.simulate(v, fp.signals.steps([13.0], 1.0))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")
    with caplog.at_level(logging.DEBUG, logger="shipfp_rs"):
        fp.simulate(LAUNCH, fp.signals.steps([13.0], 1.0))
    assert {record.name for record in caplog.records} == {"shipfp_rs"}
    assert "Stan Launch 804" in caplog.text


def test_every_frequency_of_the_public_surface_names_its_unit() -> None:
    wrong = []
    for owner in (fp, fp.signals, fp.frequency, fp.tacho):
        for name in owner.__all__:
            thing = getattr(owner, name)
            if not callable(thing):
                continue
            try:
                parameters = inspect.signature(thing).parameters
            except ValueError:  # built-in exceptions have none
                continue
            wrong += [f"{name}({key})" for key in parameters if "freq" in key and not key.endswith("_hz")]
    assert not wrong


SCRIPT = """\
from collections.abc import Sequence

import shipfp_rs as fp


def fit(trials: Sequence[fp.Experiment], tau_n: float) -> dict[str, float | None]:
    structure = fp.Structure.linear(torque="gauge", products=True).with_fixed(tau_n=tau_n)
    found: fp.Fingerprint = fp.identify(trials, structure, noise="white")
    return {name: estimate.value for name, estimate in found.parameters.items()}


launch = fp.Vessel.load("stan-launch-804")
trial: fp.Experiment = fp.simulate(launch, fp.signals.steps([13.0, -13.0], 10.0), noise={"n_e": 0.01}, seed=1)
response: fp.FrequencyResponse = fp.linearise(launch).frequency_response([0.1, 1.0])
samples: float = float(trial.signals["n_e"][0])
back: fp.Experiment = fp.Experiment.from_arrow(trial.to_arrow())
print(fit([back], 1.51), fp.plot.bode(response), samples)
"""


@pytest.mark.slow
def test_a_users_script_passes_mypy_strict_and_a_wrong_one_does_not(tmp_path) -> None:
    api = pytest.importorskip("mypy.api")
    good, bad = tmp_path / "good.py", tmp_path / "bad.py"
    good.write_text(SCRIPT)
    bad.write_text(SCRIPT.replace("[13.0, -13.0], 10.0", "[13.0, -13.0], 'ten'"))
    # Of a package with types mypy reports only what the user's own lines do wrong.
    options = ["--strict", "--cache-dir", str(tmp_path / "cache"), "--follow-imports=silent"]
    told, trouble, _ = api.run([*options, "--ignore-missing-imports", str(good), str(bad)])
    assert trouble == ""
    errors = [line for line in told.splitlines() if ": error:" in line]
    assert len(errors) == 1, told
    assert 'incompatible type "str"; expected "float"' in errors[0]


def test_importing_the_package_loads_nothing_heavy_and_costs_less_than_numpy(capsys) -> None:
    # NumPy, which every user imports, takes about a tenth of a second where the whole may take a quarter.
    # Processor seconds, the best of three: what else the machine does adds nothing.
    code = (
        "import sys, time; start = time.process_time(); import shipfp_rs; between = time.process_time(); "
        "loaded = {name.partition('.')[0] for name in sys.modules}; middle = time.process_time(); import numpy; "
        "print(between - start, time.process_time() - middle, *sorted(loaded))"
    )
    told = [
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout.split()
        for _ in range(3)
    ]
    own, numpy = (min(float(words[place]) for words in told) for place in (0, 1))
    loaded = told[0][2:]
    heavy = "numpy scipy pandas xarray polars matplotlib pydantic pyarrow rich typer control"
    assert not set(heavy.split()) & set(loaded)
    with capsys.disabled():
        print(f"\nimport shipfp_rs: {1e3 * own:.0f} ms above bare Python, NumPy {1e3 * numpy:.0f} ms")
    assert own < numpy
