"""Counts circles of modules and imports that look up the house, those in functions and under TYPE_CHECKING included.

The order of the rooms stands in pyproject.toml, in the layers that import-linter enforces: highest first.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import grimp

ROOT = Path(__file__).parents[1]
PACKAGE = "shipfp_rs"


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Return the strongly connected sets of more than one node (Tarjan 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in graph[node]:
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            at = stack.index(node)
            members = stack[at:]
            del stack[at:]
            if len(members) > 1:
                found.append(sorted(members))

    for node in sorted(graph):
        if node not in index:
            visit(node)
    return found


def main() -> int:
    """Print what was found; the exit status is 1 where anything was."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    layers = settings["tool"]["importlinter"]["contracts"][0]["layers"]
    level = {
        room: height
        for height, line in enumerate(reversed(layers))
        for room in line.replace("(", "").replace(")", "").replace(" ", "").replace(":", "|").split("|")
    }
    sys.path.insert(0, str(ROOT / "python"))  # the tree's package, not one that is installed
    graph = grimp.build_graph(PACKAGE, cache_dir=None)
    modules = {module for module in graph.modules if module != PACKAGE}
    imports = {
        module: {other for other in graph.find_modules_directly_imported_by(module) if other in modules}
        for module in modules
    }

    def room(module: str) -> str:
        return module.split(".")[1]

    # The package's own lazy table of names is the door of the house, no room of it.
    rooms = sorted({room(module) for module in modules})
    missing = [name for name in rooms if name not in level]
    upward = sorted(
        (module, other)
        for module in modules
        for other in imports[module]
        if room(module) in level and room(other) in level and level[room(module)] < level[room(other)]
    )
    between = {
        name: {room(other) for module in modules if room(module) == name for other in imports[module]}
        - {name}
        for name in rooms
    }
    of_modules, of_rooms = circles(imports), circles(between)
    for title, lines in (
        ("rooms without a layer", missing),
        ("imports of a higher room", [f"{module} -> {other}" for module, other in upward]),
        ("circles of rooms", [", ".join(members) for members in of_rooms]),
        ("circles of modules", [", ".join(members) for members in of_modules]),
    ):
        print(f"{len(lines)} {title}")
        for line in lines:
            print(f"    {line}")
    return 1 if missing or upward or of_modules or of_rooms else 0


if __name__ == "__main__":
    sys.exit(main())
