"""`process` over 3.2 hours of a log against pyarrow's reading of the same file: time, memory, and the same answer.

`inspect` has a row as well: its memory must not grow with the log, which `--hours` makes longer.

Build with `maturin develop --release`, then `python -m benches.bench_long_log`. The log (114 million samples, five channels
at 2 kHz, Parquet) is simulated first. Reading and processing take turns, each in a process of its own on two cores,
since a shared machine is faster at one time than at another; imports are not timed. The processors' own seconds stand
beside the clock's: where others use the machine they change less.
"""

import argparse
import hashlib
import json
import resource
import statistics
import sys
import tempfile
import time
from pathlib import Path

from benches.long_log import RUN2_S, long_log, trial_text
from benches.parts import apart, read_whole
from benches.timing import print_table

CHUNKS = (1 << 20, 1 << 16, 99_991)
"""Samples read at once; the first is the default."""


def process(folder: Path, chunk: int) -> dict[str, float | str]:
    """Make the experiments of the whole log; a digest of all their bits."""
    import shipfp_rs as fp

    assert fp.process  # imports what it needs
    trial = fp.Trial.load(folder / "TRIAL.toml")
    start, busy_s = time.perf_counter(), time.process_time()
    experiments = fp.process(trial.logs()[0], trial, chunk=chunk)
    seconds, busy_s = time.perf_counter() - start, time.process_time() - busy_s
    digest = hashlib.sha256()
    for experiment in experiments:
        for name, values in experiment.signals.items():
            digest.update(name.encode() + values.tobytes())
        digest.update(repr((experiment.operating_point, experiment.provenance["faults"])).encode())
    return {"seconds": seconds, "busy_s": busy_s, "digest": digest.hexdigest()}


def inspect(folder: Path) -> dict[str, float]:
    """Look through the whole log as `shipfp inspect` does."""
    import shipfp_rs as fp
    from shipfp_rs.inspection import inspect_log

    start, busy_s = time.perf_counter(), time.process_time()
    inspect_log(fp.Log.open(folder / "run2.parquet"))
    return {"seconds": time.perf_counter() - start, "busy_s": time.process_time() - busy_s}


def part(arguments: list[str]) -> None:
    """Do one part and print what it took."""
    name, folder, *rest = arguments
    path = Path(folder)
    if name == "read":
        result = read_whole(path / "run2.parquet")
    else:
        result = inspect(path) if name == "inspect" else process(path, int(rest[0]))
    print(json.dumps({**result, "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two minutes of log, just to see that it runs")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--hours", type=float, default=RUN2_S / 3600.0)
    parser.add_argument("--folder", help="keep the log there, or take it from there")
    parser.add_argument("--part", nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.part:
        part(options.part)
        return
    duration_s, repeats = (120.0, 1) if options.quick else (3600.0 * options.hours, options.repeats)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(options.folder or temporary)
        path = folder / "run2.parquet"
        if not path.exists():
            long_log(duration_s).write(path)
        (folder / "TRIAL.toml").write_text(trial_text(path.name, duration_s))
        apart("benches.bench_long_log", "read", str(folder))  # into the system's file cache
        runs = [
            (
                apart("benches.bench_long_log", "read", str(folder)),
                apart("benches.bench_long_log", "process", str(folder), str(CHUNKS[0])),
            )
            for _ in range(repeats)
        ]
        inspected = apart("benches.bench_long_log", "inspect", str(folder))
        others = [apart("benches.bench_long_log", "process", str(folder), str(chunk)) for chunk in CHUNKS[1:]]
    samples = runs[0][0]["samples"]
    print(f"{samples / 1e6:.1f} million samples, {duration_s / 3600:.2f} h; median of {repeats} turns")
    times = [statistics.median(run[k]["seconds"] for run in runs) for k in (0, 1)]
    busy = [statistics.median(run[k]["busy_s"] for run in runs) for k in (0, 1)]
    peaks = [max(run[k]["peak_mib"] for run in runs) for k in (0, 1)]
    ratio = statistics.median(ours["seconds"] / theirs["seconds"] for theirs, ours in runs)
    rows = [
        ["pyarrow.parquet.read_table", f"{times[0]:.2f}", "1.0", f"{busy[0]:.2f}", f"{peaks[0]:.0f}"],
        ["shipfp_rs.process", f"{times[1]:.2f}", f"{ratio:.1f}", f"{busy[1]:.2f}", f"{peaks[1]:.0f}"],
    ]
    seconds = inspected["seconds"]
    rows.append(
        [
            "shipfp_rs.inspection.inspect_log",
            f"{seconds:.2f}",
            f"{seconds / times[0]:.1f}",
            f"{inspected['busy_s']:.2f}",
            f"{inspected['peak_mib']:.0f}",
        ]
    )
    print_table(["", "s", "ratio", "CPU s", "peak MiB"], rows)
    digests = {run["digest"] for _, run in runs} | {run["digest"] for run in others}
    equal = "the same bits" if len(digests) == 1 else f"{len(digests)} DIFFERENT ANSWERS"
    print(f"read in chunks of {', '.join(f'{chunk:,}' for chunk in CHUNKS)} samples: {equal}")
    if len(digests) > 1:
        sys.exit(1)


if __name__ == "__main__":
    main()
