"""The package's own names, and the wheels that are configured for it."""

from __future__ import annotations

import ast
import pkgutil
import re
import sys
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


def runs_of(page: Path) -> set[str]:
    """Return the packages that a page's Python imports where the site is built."""
    code = "\n".join(re.findall(r"(?ms)^```python\n(.*?)^```", page.read_text(encoding="utf-8")))
    named = (node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Import | ast.ImportFrom))
    roots = {
        (node.module or "" if isinstance(node, ast.ImportFrom) else node.names[0].name).partition(".")[0]
        for node in named
    }
    return roots - sys.stdlib_module_names - {"shipfp_rs"}


def test_the_extra_docs_is_all_that_the_pages_of_the_site_import() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

    def names(wanted: list[str]) -> set[str]:
        extras = [extra for line in wanted for extra in re.findall(r"^shipfp_rs\[(.*)\]", line)]
        further = [name for extra in extras for name in extra.split(",")]
        plain = {re.split(r"[^\w-]", line)[0] for line in wanted} - {"shipfp_rs"}
        return plain.union(*(names(project["optional-dependencies"][name]) for name in further))

    there = names(project["dependencies"]) | names(project["optional-dependencies"]["docs"])
    for page in (ROOT / "docs").rglob("*.md"):
        assert runs_of(page) <= there, page.name


def test_every_change_is_checked_by_the_project_s_own_command() -> None:
    yaml = pytest.importorskip("yaml")
    workflow = yaml.safe_load((ROOT / ".github/workflows/checks.yml").read_text(encoding="utf-8"))
    assert "pull_request" in workflow[True]  # YAML 1.1 reads `on` as true
    assert ".ci/run" in [step.get("run") for step in workflow["jobs"]["run"]["steps"]]


def test_the_citation_names_this_version_and_the_thesis() -> None:
    yaml = pytest.importorskip("yaml")
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert cited["version"] == tomllib.loads((ROOT / "Cargo.toml").read_text())["package"]["version"]
    assert [(one["type"], one["title"]) for one in cited["references"]] == [("thesis", "Ship fingerprinting")]


def test_forms_and_hooks_name_what_exists() -> None:
    yaml = pytest.importorskip("yaml")
    bug, feature = (
        yaml.safe_load((ROOT / f".github/ISSUE_TEMPLATE/{name}.yml").read_text(encoding="utf-8"))
        for name in ("bug", "feature")
    )
    assert {"log", "inspect"} <= {part.get("id") for part in bug["body"]}
    assert feature["body"]
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    for hook in hooks["repos"][0]["hooks"]:
        for part in hook["entry"].split():
            if part.endswith(".py"):
                assert (ROOT / part).is_file(), part
