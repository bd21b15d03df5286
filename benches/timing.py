"""Timing for the benchmarks: medians, spreads of ratios, and a table of them."""

import argparse
import statistics
import time
from collections.abc import Callable, Mapping, Sequence


def asked(described: str | None, quick: Mapping[str, object], **usual: float) -> argparse.Namespace:
    """Read the command line: an option for each usual value, and `--quick`, which puts other values in their place."""
    parser = argparse.ArgumentParser(description=described)
    for name, value in usual.items():
        parser.add_argument(f"--{name}", type=type(value), default=value)
    parser.add_argument("--quick", action="store_true", help="short inputs, just to see that it runs")
    options = parser.parse_args()
    if options.quick:
        vars(options).update(quick)
    return options


def median_time(function: Callable[[], object], repeats: int = 7) -> float:
    """Return the median wall time of a call in seconds; one call before it warms caches and compiles."""
    function()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def in_turn(calls: Mapping[str, Callable[[], object]], repeats: int = 7) -> dict[str, list[float]]:
    """Return the processor seconds of every call in every round; within a round they run one after the other.

    Processor time leaves out what neighbours on the machine take; all calls here run on one thread.
    """
    times: dict[str, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        call()
    for _ in range(repeats):
        for name, call in calls.items():
            start = time.process_time()
            call()
            times[name].append(time.process_time() - start)
    return times


def spread(ratios: Sequence[float]) -> str:
    """Median of the ratios and, in brackets, their quartiles."""
    low, middle, high = (
        statistics.quantiles(ratios, n=4, method="inclusive") if len(ratios) > 1 else [ratios[0]] * 3
    )
    return f"{middle:.3g} [{low:.3g}, {high:.3g}]"


def print_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print rows under a header, the first column to the left, the others to the right."""
    widths = [max(len(row[column]) for row in (header, *rows)) for column in range(len(header))]
    for row in (header, ["-" * width for width in widths], *rows):
        first, *others = (f"{cell:{'<' if i == 0 else '>'}{widths[i]}}" for i, cell in enumerate(row))
        print("  ".join([first, *others]))
