"""What a page of a folder may ask for: logs with the trials that name them, roles of channels, the ship."""

import os

import numpy as np
import pytest

from shipfp_rs.logs.log import Log
from shipfp_rs.view.document import Document
from shipfp_rs.view.draft import Draft, written
from tests.view.serving import served
from tests.view.test_jobs import TRIAL, follow


@pytest.fixture
def folder(tmp_path):
    """Two short logs, and three trials: two of the one log, none of the other, one that can't be read."""
    samples = np.random.default_rng(0).normal(100.0, 1.0, 2000)
    for name in ("one", "two"):
        Log.from_arrays({"n_set": samples, "M": samples}, rate_hz=100.0).write(tmp_path / f"{name}.parquet")
    for age, name in enumerate(("new", "old", "broken")):
        text = written(Draft.model_validate(TRIAL | {"name": name}), None, "one.parquet")
        text = text.replace("start_s = 40.0", 'start_s = "x"') if name == "broken" else text
        (tmp_path / f"{name}.toml").write_text(text)
        os.utime(tmp_path / f"{name}.toml", (1e9 - age, 1e9 - age))
    return tmp_path


def test_a_log_is_opened_with_the_newest_trial_that_names_it(folder):
    with served(folder) as caller:
        docs = {log["name"]: log["doc"] for log in caller.get("folder")["logs"]}
        told = caller.get("draft", doc=docs["one.parquet"])
        assert (told["file"], told["draft"]["name"]) == ("new.toml", "new")
        assert told["version"]
        assert [window["name"] for window in told["draft"]["windows"]] == ["C1"]
        assert [other["name"] for other in told["others"]] == ["old.toml"]
        assert caller.get("draft", doc=told["others"][0]["doc"])["file"] == "old.toml"
        other = caller.get("draft", doc=docs["two.parquet"])
        assert (other["file"], other["version"], other["others"]) == ("TRIAL.toml", "", [])


def test_what_a_log_taken_with_its_trial_saves_goes_into_that_file(folder):
    with served(folder) as caller:
        doc = caller.server.desk.open_log(folder / "one.parquet")
        told = caller.get("draft", doc=doc)
        draft = told["draft"] | {"name": "changed"}
        saved = caller.post(
            "save", {"doc": doc, "draft": draft, "file": told["file"], "version": told["version"]}
        )
        assert (saved["status"], saved["file"], saved["doc"]) == (200, "new.toml", doc)
    assert 'name = "changed"' in (folder / "new.toml").read_text()


def write_genset(path):
    """A set point that rests, the power of a generator that goes up and down, and the speed that answers."""
    random = np.random.default_rng(0)
    rate_hz, steps = 50.0, np.repeat(random.choice([0.3, 0.9, 0.6], 60), 100)
    steps[:1500] = steps[-1000:] = 0.5
    load, speed, total = 200e3 * steps, np.empty(steps.size), 0.0
    n = 1500.0
    for k, power in enumerate(load):
        total += (1500.0 - n) / rate_hz
        n += (8.0 * (1500.0 - n) + 4.0 * total - 2e-3 * (power - 100e3)) / (2.0 * rate_hz)
        speed[k] = n
    channels = {
        "n_set": np.full(steps.size, 1500.0),
        "Generator power": load / 1e3 + random.normal(0.0, 0.3, steps.size),
        "n_e": speed + random.normal(0.0, 0.5, steps.size),
    }
    units = {"n_set": "rpm", "Generator power": "kW", "n_e": "rpm"}
    Log.from_arrays(channels, rate_hz=rate_hz, units=units).write(path)


def test_a_log_in_which_only_the_load_moves_is_marked_and_checked_from_what_the_page_is_told(tmp_path):
    write_genset(tmp_path / "genset.parquet")
    with served(tmp_path) as caller:
        doc = caller.server.desk.open_log(tmp_path / "genset.parquet")
        told = caller.get("draft", doc=doc)
        assert [one["role"] for one in told["guess"]] == ["set_point", "load", "speed"]
        assert told["factors"]["Generator power"]["load"] == {"factor": 1000.0, "quantity": "power"}
        asked = {"doc": doc, "driver": "n_set", "load": "Generator%20power"}
        while (found := caller.get("windows", **asked))["state"] == "working":
            pass
        assert found["column"] == "Generator power"
        (window,) = [one for one in found["windows"] if one["kind"] != "steady"]
        assert found["rest"][1] <= window["start_s"] + 1.0
        keys = ("name", "kind", "start_s", "stop_s")
        draft = told["draft"] | {
            "channels": told["guess"],
            "steady_s": found["rest"],
            "windows": [{key: window[key] for key in keys}],
        }
        saved = caller.post("save", {"doc": doc, "draft": draft, "file": "TRIAL.toml", "version": ""})
        assert saved["status"] == 200, saved
        checked = follow(caller, caller.post("job", {"kind": "check", "file": "TRIAL.toml"}))
        assert checked["state"] == "done", checked
        assert any(one["what"] == "load (power)" for one in checked["done"]["channels"])
        layer = Document(tmp_path / "genset.parquet", trial=tmp_path / "TRIAL.toml").faults.wait()["faults"]
        assert [(one["kind"], one["channel"]) for one in layer] == []
