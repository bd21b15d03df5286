"""`shipfp view` of a long log: first overview against pyarrow's reading of the file, second opening, zoom and pan, memory.

`python -m benches.bench_view` takes half an hour of log (18 million samples, five channels at 2 kHz, Parquet); `--full` the
trial's 3.2 hours (114 million), `--hours 27.8` 10^9 samples. Reading and opening take turns, each in a process of its own
on two cores, imports not timed. The processors' own seconds stand beside the clock's: where others use the machine they
change less. Zoom and pan are timed in Chromium, from the call to the drawing made of the stretch's own tiles, and the
wheel from the turn of it to the frame after that drawing; without Playwright and Chromium they are left out. The pointer
stands where the zoom goes to, and a tenth of a second lies between two moves. Build with `maturin develop --release` first.
"""

import argparse
import json
import os
import random
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benches.long_log import RUN2_S, long_log
from benches.parts import apart, read_whole
from benches.timing import print_table

MOVES = 120
NOTCHES = 24
"""Turns of the wheel from all of a log of 10^9 samples down to single ones."""
NOTCH = -240
PAUSE_MS = 100
"""Between two moves; a hand is slower."""
WHEEL = """async () => {
  const stage = document.getElementById("stage");
  const turned = await new Promise((done) => stage.addEventListener("wheel", done, { once: true, passive: true }));
  await shipfp.view.whenSettled();
  await new Promise((done) => requestAnimationFrame(() => {
    const { port1, port2 } = new MessageChannel();  // a message comes after the frame is painted
    port1.onmessage = done;
    port2.postMessage(null);
  }));
  return performance.now() - turned.timeStamp;
}"""
ON_SCREEN_MS, SERVER_MIB, PAGE_MIB = 50.0, 1024.0, 300.0
"""Aims: 95th percentile of zoom and pan, most memory of the server and of the page."""


def overview(path: Path, again: bool) -> dict[str, float]:
    """Open a log as the page does, up to the tiles of its coarsest level; the last of three times, as it is read."""
    from shipfp_rs.view import pyramid
    from shipfp_rs.view.document import Document

    Document(path).log()  # imports what the format needs
    times = []
    for _ in range(1 if again else 3):
        if not again:
            for place in pyramid.places(path):
                place.unlink(missing_ok=True)
        start, busy_s = time.perf_counter(), time.process_time()
        document = Document(path)
        for series in document.series():
            series.tile(series.depth - 1, 0)
        times.append((time.perf_counter() - start, time.process_time() - busy_s))
    return {"seconds": times[-1][0], "busy_s": times[-1][1], "cold_s": times[0][0]}


def part(name: str, path: Path) -> None:
    """Do one part and print what it took."""
    result = read_whole(path) if name == "read" else overview(path, again=name == "again")
    print(json.dumps({**result, "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}))


def peak_mib(pid: int) -> float:
    """Most memory that a process has had; the pages of mapped files, which the system may take back, included."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024


def page_pid(browser: Any) -> int:
    """Return the process that draws the page: of Chromium's renderers the one that has worked most."""
    every = browser.new_browser_cdp_session().send("SystemInfo.getProcessInfo")["processInfo"]
    return int(max((one for one in every if one["type"] == "renderer"), key=lambda one: one["cpuTime"])["id"])


@dataclass(frozen=True)
class Moved:
    """Milliseconds of moves until drawn, of the wheel's until painted; the most memory of server and page [MiB]."""

    zooms: list[float]
    pans: list[float]
    wheel: list[float]
    server_mib: float
    page_mib: float


def called(page: Any, moves: int) -> tuple[list[float], list[float]]:
    """Time calls that zoom in and move aside, from all of a log down to its samples about one place after the other."""
    chance = random.Random(0)
    zooms, pans = [], []
    first, last = page.evaluate("[shipfp.view.first, shipfp.view.last]")
    for move in range(moves):
        if move % 12 == 0:
            about = chance.uniform(first, last)
            page.evaluate(
                "(about) => { shipfp.view.all(); shipfp.view.setPointer(about); return shipfp.view.whenSettled(); }",
                about,
            )
            page.wait_for_timeout(PAUSE_MS)
        kind, call = (pans, "shift(0.3)") if move % 4 == 3 else (zooms, "zoom(0.25)")
        timed = (
            f"async () => {{ const began = performance.now(); shipfp.view.{call}; "
            "await shipfp.view.whenSettled(); return performance.now() - began; }"
        )
        kind.append(page.evaluate(timed))
        page.wait_for_timeout(PAUSE_MS)
    return zooms, pans


def wheeled(page: Any, moves: int) -> list[float]:
    """Time turns of the wheel from all of a log down to its samples, the pointer at one place after the other."""
    chance = random.Random(1)
    box = page.locator(".row canvas").first.bounding_box()
    took = []
    for move in range(moves):
        if move % NOTCHES == 0:
            page.mouse.move(box["x"] + chance.uniform(0.2, 0.9) * box["width"], box["y"] + 30)
            page.evaluate("() => { shipfp.view.all(); return shipfp.view.whenSettled(); }")
        page.wait_for_timeout(PAUSE_MS)
        page.evaluate(f"() => {{ window.turning = ({WHEEL})(); }}")
        page.mouse.wheel(0, NOTCH)
        took.append(page.evaluate("window.turning"))
    return took


def on_screen(path: Path, moves: int) -> Moved | None:
    """Open a log in Chromium and move about in it; None without Playwright and Chromium."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return None
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        return None
    command = [sys.executable, "-m", "shipfp_rs.cli", "view", str(path), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server, sync_playwright() as driver:
        try:
            address = next(word for word in server.stdout.readline().split() if word.startswith("http"))
            arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
            browser = driver.chromium.launch(executable_path=chromium, args=arguments)
            page = browser.new_page(viewport={"width": 1400, "height": 900})
            page.set_default_timeout(600_000)
            page.goto(address)
            page.wait_for_selector("body[data-ready]")
            page.wait_for_selector("body[data-faults]")  # inspection takes both processors until it is done
            moved = Moved(
                *called(page, moves), wheeled(page, moves), peak_mib(server.pid), peak_mib(page_pid(browser))
            )
            browser.close()
        finally:
            server.terminate()
    return moved


def told(what: str, took: list[float]) -> str:
    """Say how long moves took."""
    late = sorted(took)[min(int(0.95 * len(took)), len(took) - 1)]
    return (
        f"{what} in Chromium: median {statistics.median(took):.0f} ms, 95th percentile {late:.0f} ms "
        f"(aim {ON_SCREEN_MS:.0f} ms)"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two minutes of log, just to see that it runs")
    parser.add_argument("--full", action="store_true", help="3.2 hours, 114 million samples")
    parser.add_argument(
        "--hours", type=float, default=0.5, help="length of the log; 36 million samples an hour"
    )
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--folder", help="keep the log there, or take it from there")
    parser.add_argument("--part", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.part:
        part(options.part[0], Path(options.part[1]))
        return
    length_s = RUN2_S if options.full else 3600.0 * options.hours
    duration_s, repeats = (120.0, 1) if options.quick else (length_s, options.repeats)
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(options.folder or temporary) / f"run2-{duration_s:.0f}.parquet"
        if not path.exists():
            long_log(duration_s).write(path)
        apart("benches.bench_view", "read", str(path))  # into the system's file cache
        runs = [
            tuple(apart("benches.bench_view", name, str(path)) for name in ("read", "first", "again"))
            for _ in range(repeats)
        ]
        moved = on_screen(path, 12 if options.quick else MOVES)
    print(
        f"{runs[0][0]['samples'] / 1e6:.1f} million samples, {duration_s / 3600:.2f} h; median of {repeats} turns"
    )
    names = ("pyarrow.parquet.read_table", "first overview", "second opening")
    rows = []
    for k, name in enumerate(names):
        row = [name]
        for unit in ("seconds", "busy_s"):
            took = statistics.median(run[k][unit] for run in runs)
            ratio = statistics.median(run[k][unit] / run[0][unit] for run in runs)
            row += [f"{took:.3f}", f"{ratio:.2f}"]
        rows.append([*row, f"{max(run[k]['peak_mib'] for run in runs):.0f}"])
    print_table(["", "s", "ratio", "CPU s", "ratio", "peak MiB"], rows)
    cold_s = statistics.median(run[1]["cold_s"] for run in runs)
    print(f"first overview of a fresh process, whose memory is cold: {cold_s:.2f} s")
    if moved is None:
        print("zoom and pan: left out, they need Playwright and Chromium")
        return
    print(
        told(f"{len(moved.zooms)} zooms and {len(moved.pans)} pans until drawn", [*moved.zooms, *moved.pans])
    )
    print(told(f"{len(moved.wheel)} turns of the wheel until painted", moved.wheel))
    print(
        f"most memory: server {moved.server_mib:.0f} MiB (aim {SERVER_MIB:.0f}), "
        f"page {moved.page_mib:.0f} MiB (aim {PAGE_MIB:.0f}); "
        "shared libraries and the pages of mapped files included"
    )


if __name__ == "__main__":
    main()
