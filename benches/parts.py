"""Parts of a benchmark that take turns, each in a process of its own on two cores."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

CORES = 2


def read_whole(path: Path) -> dict[str, float]:
    """Read the whole file into memory, three times; the last one finds its memory warm."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    pa.set_cpu_count(CORES)
    for _ in range(3):
        table = None
        start, busy_s = time.perf_counter(), time.process_time()
        table = pq.read_table(path)
        seconds, busy_s = time.perf_counter() - start, time.process_time() - busy_s
    return {"seconds": seconds, "busy_s": busy_s, "samples": table.num_rows * table.num_columns}


def apart(module: str, *arguments: str) -> dict:
    """Run `module --part arguments` in a process of its own, and return the JSON that it prints."""
    cores = sorted(os.sched_getaffinity(0))[:CORES]
    done = subprocess.run(
        [sys.executable, "-m", module, "--part", *arguments],
        check=True,
        capture_output=True,
        text=True,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        preexec_fn=lambda: os.sched_setaffinity(0, cores),
    )
    return json.loads(done.stdout)
