"""The package's own names."""

from __future__ import annotations

import pkgutil

import shipfp_rs as fp


def test_no_exported_object_is_hidden_by_a_module_of_its_name() -> None:
    # Importing a submodule binds it on the package, over anything of the same name that is loaded on demand.
    assert not set(fp._WHERE) & {module.name for module in pkgutil.iter_modules(fp.__path__)}
