"""What a page of a folder may ask for: logs with the trials that name them, roles of channels, the ship."""

import os

import numpy as np
import pytest

from shipfp_rs.logs.log import Log
from shipfp_rs.view.draft import Draft, written
from tests.view.serving import served
from tests.view.test_jobs import TRIAL


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
