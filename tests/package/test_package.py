"""The package's own names, and the wheels that are configured for it."""

from __future__ import annotations

import pkgutil
import tomllib
from pathlib import Path

import pytest

import shipfp_rs as fp

ROOT = Path(__file__).parents[2]


def test_no_exported_object_is_hidden_by_a_module_of_its_name() -> None:
    # Importing a submodule binds it on the package, over anything of the same name that is loaded on demand.
    assert not set(fp._WHERE) & {module.name for module in pkgutil.iter_modules(fp.__path__)}


def test_wheels_serve_every_python_that_the_package_asks_for_on_every_platform() -> None:
    """PEP 803: abi3 wheels need a global lock, abi3t ones Python 3.15; between them stands a wheel for 3.14t alone."""
    yaml = pytest.importorskip("yaml")
    workflow = yaml.safe_load((ROOT / ".github/workflows/wheels.yml").read_text(encoding="utf-8"))
    matrix = workflow["jobs"]["wheel"]["strategy"]["matrix"]
    served = {(platform["os"].split("-")[0], platform["target"]) for platform in matrix["platform"]}
    assert served == {
        ("ubuntu", "x86_64"),
        ("ubuntu", "aarch64"),
        ("macos", "x86_64"),
        ("macos", "aarch64"),
        ("windows", "x64"),
    }
    oldest = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["requires-python"].strip(">=")
    features = tomllib.loads((ROOT / "Cargo.toml").read_text())["dependencies"]["pyo3"]["features"]
    assert features == [f"abi3-py{oldest.replace('.', '')}", "abi3t-py315"]
    assert matrix["python"] == [oldest, "3.14t", "3.15t"]
    assert {"sdist", "wheel"} == set(workflow["jobs"]["publish"]["needs"])
