"""A folder with what every command can meet."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.gallery.inputs import prepare


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("prepared")
    prepare(made)
    return made
