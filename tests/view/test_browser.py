"""The page in Chromium: every spike is seen, a newcomer gets from a CSV to a report, and nothing is asked of anyone else."""

import contextlib
import json
import os
import re
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from shipfp_rs import cli
from shipfp_rs.logs.log import Log
from shipfp_rs.view.draft import Draft, written
from tests.report.test_report_browser import HOSTILE, PHONE
from tests.report.test_report_browser import Visit as PageVisit
from tests.view.serving import CHIRP_S, STEADY_S, served, write_csv
from tests.view.test_jobs import TRIAL

DESKTOP = {"width": 1400, "height": 900}
SLOW_MS = 1000 * int(os.environ.get("VIEW_WAIT_S", "30"))
"""Longest wait for the page; a machine that is shared by many needs more."""
TOP, BOTTOM = 6, 6
"""Of a row's canvas, as `draw.js` has them."""


class Visit(PageVisit):
    """An open page of a log."""

    def __init__(self, browser, address: str, viewport=DESKTOP, **options) -> None:
        page = browser.new_page(viewport=viewport, **options)
        page.set_default_timeout(SLOW_MS)
        super().__init__(page, address, "body[data-ready]")

    def show(self, start_s: float, stop_s: float) -> None:
        """Show a stretch, and wait until it is drawn from its own tiles."""
        self.page.evaluate(
            "([from, to]) => { shipfp.view.show(from, to); return shipfp.view.whenSettled(); }",
            [start_s, stop_s],
        )

    def shown(self) -> tuple[float, float]:
        return tuple(self.page.evaluate("[shipfp.view.from, shipfp.view.to]"))

    def fill(self, label: str, text: str, **options) -> None:
        """Write into a field, and leave it."""
        self.page.get_by_label(label, **options).fill(text)
        self.page.get_by_label(label, **options).press("Tab")

    def take_roles(self) -> None:
        self.page.get_by_role("button", name="take the roles that names and units tell").click()

    def drag(self, start_s: float, stop_s: float) -> None:
        """Drag over the first row from one time to another."""
        box = self.page.locator(".row canvas").first.bounding_box()
        first, last = (
            self.page.evaluate("(time) => shipfp.view.xOf(time)", time) + box["x"]
            for time in (start_s, stop_s)
        )
        self.page.mouse.move(first, box["y"] + 30)
        self.page.mouse.down()
        self.page.mouse.move(last, box["y"] + 40, steps=5)
        self.page.mouse.up()


@pytest.fixture
def look(browser):
    """Open the page of a log whose folder is served meanwhile."""
    with contextlib.ExitStack() as stack:

        def open_page(path: Path, viewport=DESKTOP) -> Visit:
            server = stack.enter_context(served(path.parent)).server
            address = f"{server.origin}/{server.token}/look.html?doc={server.desk.open(path)}"
            visit = Visit(browser, address, viewport)
            stack.callback(visit.page.close)
            return visit

        yield open_page


@pytest.fixture(scope="module")
def spiky(tmp_path_factory) -> tuple[Path, np.ndarray, np.ndarray]:
    """A million samples with a thousand spikes of one sample each, of different heights, both ways."""
    random = np.random.default_rng(1)
    samples = random.normal(0.0, 1.0, 1_000_000).astype(np.float32)
    places = np.sort(random.choice(samples.size, 1000, replace=False))
    samples[places] = random.uniform(20.0, 60.0, 1000) * random.choice([-1.0, 1.0], 1000)
    path = tmp_path_factory.mktemp("spiky") / "log.parquet"
    Log.from_arrays({"torque": samples}, rate_hz=1000.0, units={"torque": "Nm"}).write(path)
    return path, samples, places


def test_every_spike_is_on_the_screen_at_every_zoom(look, spiky):
    """In each column of pixels with a spike, what is drawn reaches the highest and the lowest one."""
    path, samples, places = spiky
    visit = look(path)
    page = visit.page
    page.evaluate("shipfp.view.layers.faults = false")
    seen = 0
    for wide in (1000.0, 600.0, 250.0, 60.0, 15.0, 4.0, 1.0, 0.25, 0.05):
        start = 0.0 if wide == 1000.0 else places[places.size // 2] / 1000.0 - 0.4 * wide
        visit.show(start, start + wide)
        picture = imread(BytesIO(page.screenshot()))[..., :3]
        raw = page.evaluate("shipfp.view.palette().raw")
        colour = np.array([int(part, 16) / 255 for part in re.findall("..", raw[1:])])
        drawn = np.abs(picture - colour).sum(axis=2) < 0.35
        box = page.locator(".row canvas").first.bounding_box()
        low, high = page.evaluate("shipfp.view.rows[0].range")
        from_s, to_s = visit.shown()
        assert to_s - from_s == pytest.approx(wide)
        columns = round(box["width"] - 62 - 10)
        inside = places[(places / 1000.0 > from_s) & (places / 1000.0 < to_s)]
        at = np.floor((inside / 1000.0 - from_s) / wide * columns).astype(int)
        for column in np.unique(at):
            values = samples[inside[at == column]]
            x = round(box["x"]) + 62 + column
            rows = np.flatnonzero(
                drawn[round(box["y"]) : round(box["y"] + box["height"]), x - 1 : x + 3].any(axis=1)
            )
            for value in (values.max(), values.min()):
                y = TOP + (high - value) / (high - low) * (box["height"] - TOP - BOTTOM)
                assert np.abs(rows - y).min() <= 2.5, f"{value:.1f} hidden in column {column} at {wide} s"
            seen += len(values)
    print(f"{seen} spikes looked at in {9} zooms")
    assert seen > 1900
    assert visit.complaints == []


@pytest.fixture(scope="module")
def tug(tmp_path_factory) -> Path:
    """A trial of the tug with a name that is no name."""
    folder = tmp_path_factory.mktemp("tug")
    write_csv(folder / "my.csv")
    text = written(Draft.model_validate(TRIAL | {"name": HOSTILE}), None, "my.csv")
    (folder / "TRIAL.toml").write_text(text)
    run = folder / HOSTILE.replace("/", "_")
    run.mkdir()
    (run / "fingerprint.json").write_text(json.dumps({"vessel": HOSTILE, "verdict": [HOSTILE]}))
    (run / "report.html").write_text("<script>parent.broken = true; fetch('/')</script><p>a report</p>")
    log = (folder / "my.csv").read_text().replace("shaft torque [Nm]", '"<img src=x onerror=alert(1)> [Nm]"')
    (folder / "hostile.csv").write_text(log)
    return folder


@pytest.fixture(scope="module")
def server(tug):
    with served(tug) as caller:
        yield caller.server


@pytest.fixture
def visits(browser, tug, server):
    pages = []

    def open_page(name: str = "TRIAL.toml", **options) -> Visit:
        path = tug / name
        doc = server.desk.open_trial(path)[0] if path.suffix == ".toml" else server.desk.open(path)
        pages.append(Visit(browser, f"{server.origin}/{server.token}/look.html?doc={doc}", **options))
        return pages[-1]

    yield open_page
    for visit in pages:
        visit.page.close()


@pytest.mark.parametrize(
    ("viewport", "scheme"), [(DESKTOP, "light"), (PHONE, "dark")], ids=["desktop", "phone"]
)
def test_it_draws_in_either_light_at_either_width_and_asks_nobody(visits, viewport, scheme):
    visit = visits(viewport=viewport, color_scheme=scheme)
    page = visit.page
    page.wait_for_selector("body[data-faults]")
    assert visit.complaints == []
    origin = page.evaluate("location.origin")
    assert {url.split("/")[2] for url in visit.requests if not url.startswith("data:")} == {
        origin.split("/")[2]
    }
    for tab in ("Trial", "Spectrum", "Results", "Keys", "Channels"):
        page.get_by_role("tab", name=tab).click()
        assert page.evaluate("document.documentElement.scrollWidth") <= viewport["width"], tab
        if folder := os.environ.get("VIEW_SCREENSHOTS"):
            page.wait_for_timeout(700)
            page.screenshot(
                path=Path(folder) / f"view-{viewport['width']}-{scheme}-{tab}.png", full_page=True
            )
    assert visit.is_drawn_in(scheme)
    painted = page.evaluate(
        "shipfp.view.rows.map((row) => row.columns[0].low.some((value) => value === value))"
    )
    assert painted == [True, True, True]


def test_names_are_text_and_nothing_else(visits):
    visit = visits("hostile.csv")
    page = visit.page
    assert "<img src=x onerror=alert(1)>" in page.locator(".row .name").nth(1).inner_text()
    other = visits()
    other.page.get_by_role("tab", name="Results").click()
    other.page.locator("#results").get_by_text(HOSTILE).first.wait_for()
    for one in (page, other.page):
        assert one.locator("img").count() == 0
        assert one.evaluate("window.broken") is None
    card = other.page.locator("#results .card").first
    assert card.locator("a, button").first.inner_text() == "open the report"
    other.page.get_by_role("button", name="report beside").click()
    frame = other.page.frame_locator("iframe")
    assert frame.locator("p").inner_text() == "a report"
    assert other.page.evaluate("window.broken") is None  # the report's script runs apart
    assert any(re.search("refused|blocked|security", text, re.IGNORECASE) for text in other.complaints)


def test_it_obeys_keys_wheel_and_drag(visits):
    visit = visits()
    page = visit.page
    whole = visit.shown()
    page.locator("#stage").focus()
    middle = 0.5 * sum(whole)
    for key, check in (
        ("+", lambda a, b: b - a == pytest.approx(0.5 * (whole[1] - whole[0]))),
        ("Home", lambda a, b: a == pytest.approx(whole[0])),
        ("ArrowRight", lambda a, b: a > whole[0]),
        ("End", lambda a, b: b == pytest.approx(whole[1])),
        ("0", lambda a, b: (a, b) == pytest.approx(whole)),
    ):
        page.keyboard.press(key)
        assert check(*visit.shown()), key
    box = page.locator(".row canvas").first.bounding_box()
    at = page.evaluate("(time) => shipfp.view.xOf(time)", middle) + box["x"]
    page.mouse.move(at, box["y"] + 30)
    page.mouse.wheel(0, -240)
    page.wait_for_function(
        "(wide) => shipfp.view.to - shipfp.view.from < wide", arg=0.9 * (whole[1] - whole[0])
    )
    assert 0.5 * sum(visit.shown()) == pytest.approx(middle, abs=2.0)
    visit.drag(50.0, 60.0)
    assert visit.shown() == pytest.approx((50.0, 60.0), abs=0.3)
    for _ in range(40):
        page.mouse.wheel(0, -240)
    page.wait_for_function("shipfp.view.to - shipfp.view.from < 0.009")  # four samples at 500 Hz
    page.evaluate("shipfp.view.whenSettled()")
    assert page.evaluate("shipfp.view.rows[0].columns[0].sparse")


def test_the_next_turns_of_the_wheel_find_their_tiles_here(look, spiky):
    """Where the pointer rests, what four turns of a quarter each show is asked for ahead."""
    visit = look(spiky[0])
    visit.page.evaluate("shipfp.view.setPointer(321.0)")
    held = "() => [1, 4, 16, 64, 256].every((part) => shipfp.view.keys(321 - 321 / part, 321 + 679 / part)"
    held += ".every((key) => shipfp.view.tiles.held.has(key)))"
    visit.page.wait_for_function(held)
    visit.page.wait_for_load_state("networkidle")
    visit.page.route("**/api/tiles*", lambda route: route.abort())
    visit.page.evaluate("() => { shipfp.view.zoom(1 / 256); return shipfp.view.whenSettled(); }")
    assert visit.page.evaluate("shipfp.view.unsharp") is False
    assert visit.page.evaluate("shipfp.view.rows[0].columns[0].level") == 1


def test_a_page_whose_server_has_gone_says_so_and_does_not_ask_on(visits):
    visit = visits()
    visit.page.wait_for_load_state("networkidle")
    visit.page.route("**/api/tiles*", lambda route: route.abort())
    visit.requests.clear()
    visit.show(60.0, 60.2)
    visit.page.get_by_text("is shipfp view still running?").wait_for()
    visit.page.wait_for_timeout(300)
    assert 1 <= len([url for url in visit.requests if "api/tiles" in url]) < 5


WRITTEN = """() => {
window.outside = [];
const write = CanvasRenderingContext2D.prototype.fillText;
CanvasRenderingContext2D.prototype.fillText = function (text, x, y, most = Infinity) {
  const wide = Math.min(this.measureText(text).width, most);
  const left = x - { left: 0, start: 0, center: 0.5 * wide, right: wide, end: wide }[this.textAlign];
  if (left < 0 || left + wide > this.canvas.clientWidth) window.outside.push(text);
  return write.call(this, text, x, y, most);
};
}"""


def test_no_number_at_an_axis_is_cut(look, tmp_path):
    path = tmp_path / "log.parquet"
    samples = -987_654.0 + 0.003 * np.sin(np.arange(6000) / 50.0)
    Log.from_arrays({"far from zero": samples}, rate_hz=100.0, units={"far from zero": "Nm"}).write(path)
    visit = look(path, PHONE)
    visit.page.evaluate(WRITTEN)
    visit.show(10.0, 40.0)
    assert visit.page.evaluate("window.outside") == []


def test_cursors_tell_the_difference_of_two_samples_and_channels_are_hidden_and_reordered(visits, tug):
    visit = visits()
    page = visit.page
    log = Log.open(tug / "my.csv")
    samples = log.read("n_set")
    visit.show(60.0, 60.2)
    first, second = 60.05, 60.15
    page.evaluate("([a, b]) => { shipfp.view.togglePin(a); shipfp.view.setPointer(b); }", [first, second])
    text = page.locator(".row .value").first.inner_text()
    told = [float(part) for part in re.findall(r"-?[\d.]+", text.replace("−", "-"))]
    expected = [float(samples[round(time * 500)]) for time in (second, first)]
    assert told[0] == pytest.approx(expected[0], abs=0.01)
    assert told[1] == pytest.approx(expected[0] - expected[1], abs=0.01)
    assert "Δt 0.1 s · 1/Δt 10 Hz" in page.locator("#status").inner_text()
    names = lambda: [row.inner_text() for row in page.locator(".row:not([hidden]) .name").all()]  # noqa: E731
    assert names() == ["n_set", "shaft torque", "PTM_e"]
    page.get_by_label("n_set down").click()
    assert names() == ["shaft torque", "n_set", "PTM_e"]
    page.get_by_label("show PTM_e").uncheck()
    assert names() == ["shaft torque", "n_set"]


def test_two_points_calibrate_at_once(visits):
    visit = visits("my.csv")
    page = visit.page
    page.get_by_label("role of PTM_e").select_option("torque")
    page.get_by_label("calibration of PTM_e").select_option("table")
    for number, (reading, value) in enumerate([("0", "100"), ("5", "1100")], start=1):
        page.get_by_role("button", name="add a reading").click()
        for what, text in (("reading", reading), ("value", value)):
            visit.fill(f"{what} {number} of PTM_e", text, exact=True)
    page.get_by_text("200 × recorded + 100 Nm").wait_for()
    page.evaluate("shipfp.view.whenSettled()")
    low, high = page.evaluate("shipfp.view.rows[2].range")
    assert low == pytest.approx(60.0, abs=40)
    assert high == pytest.approx(1150.0, abs=60)


def test_a_speed_in_per_cent_is_calibrated_on_the_page(look, tmp_path):
    time = np.arange(0.0, 60.0, 0.02)
    share = 60.0 + 5.0 * np.sin(time)
    heads = "time [s],POD_SPEED_REF_PCT,POD_SPEED_ACT_PCT,shaft_rpm"
    columns = np.column_stack((time, share, share, 20.0 * share))
    np.savetxt(tmp_path / "pod.csv", columns, fmt="%.3f", delimiter=",", comments="", header=heads)
    visit = look(tmp_path / "pod.csv")
    page = visit.page
    visit.take_roles()
    visit.fill("scale of POD_SPEED_ACT_PCT", "20")
    page.get_by_text("20 × recorded + 0 rpm").wait_for()
    assert not page.get_by_label("scale of shaft_rpm").count()
    assert visit.complaints == []


def test_a_newcomer_gets_from_a_csv_to_a_report_without_a_text_editor(look, tmp_path):
    """One button for the roles, one drag, run, report; and the file that was written says the same on the command line."""
    write_csv(tmp_path / "my.csv")
    visit = look(tmp_path / "my.csv")
    page = visit.page
    visit.take_roles()
    visit.fill("pulses a turn of PTM_e", "1")
    page.get_by_label("shaft of PTM_e").select_option("engine")
    page.get_by_role("tab", name="Trial").click()
    page.get_by_label("end of steady").wait_for()  # found in the set point
    page.get_by_role("button", name="mark a window").click()
    visit.drag(STEADY_S, STEADY_S + CHIRP_S)
    page.get_by_text(re.compile(r"found in it: chirp, a gliding sine, [\d.]+ to 1\.\d+ Hz")).wait_for()
    page.get_by_text("Complete; not saved yet.").wait_for()
    page.get_by_role("button", name="run").click()
    page.wait_for_function("() => document.querySelector('.job progress')?.value > 0.1")
    assert not page.locator(".job").get_by_text("beginning").count()
    page.wait_for_selector(".job[data-state]", timeout=10 * SLOW_MS)
    assert page.locator(".job").get_attribute("data-state") == "done", page.locator(".job").inner_text()
    page.get_by_role("button", name="open the report beside").click()
    report = page.frame_locator("iframe")
    report.locator("#answer").wait_for()
    assert re.search(r"\b[Uu]sable\b", report.locator("#answer").inner_text())
    assert visit.complaints == []
    if folder := os.environ.get("VIEW_SCREENSHOTS"):
        page.wait_for_timeout(500)
        page.screenshot(path=Path(folder) / "view-newcomer.png")
    assert {"TRIAL.toml", "shipfp-run"} <= {path.name for path in tmp_path.iterdir()}
    assert cli.main(["run", str(tmp_path / "TRIAL.toml"), "--out", str(tmp_path / "again")]) == 0
    page_made, command_made = (
        json.loads((tmp_path / name / "fingerprint.json").read_text()) for name in ("shipfp-run", "again")
    )
    assert page_made == command_made


def test_what_is_missing_stands_at_its_field_and_a_reload_loses_nothing(look, tmp_path):
    write_csv(tmp_path / "my.csv")
    visit = look(tmp_path / "my.csv")
    page = visit.page
    visit.take_roles()
    pulses, shaft = page.get_by_label("pulses a turn of PTM_e"), page.get_by_label("shaft of PTM_e")
    page.wait_for_selector("[aria-label='pulses a turn of PTM_e'][aria-invalid]")
    assert (pulses.input_value(), shaft.input_value()) == ("", "")
    for field in (pulses, shaft):
        told = page.locator(f"#{field.get_attribute('aria-describedby')}").inner_text()
        assert re.fullmatch(r"[A-Z][\w ]+\.", told)
    page.get_by_role("tab", name="Trial").click()
    assert page.get_by_role("button", name="run").is_disabled()
    assert page.locator("#trial li").count() >= 3
    page.get_by_role("button", name="pulses a turn of PTM_e").click()
    assert page.evaluate("document.activeElement.getAttribute('aria-label')") == "pulses a turn of PTM_e"
    pulses.fill("1")
    pulses.press("Tab")
    shaft.select_option("engine")
    page.reload()
    page.wait_for_selector("body[data-ready]")
    page.get_by_label("role of n_set").wait_for()
    assert [
        page.get_by_label(f"role of {name}").input_value() for name in ("n_set", "shaft torque", "PTM_e")
    ] == ["set_point", "torque", "train"]
    assert (pulses.input_value(), shaft.input_value()) == ("1", "engine")
    # The pulses of the whole log are a solid block; its speed is drawn.
    page.wait_for_function("() => shipfp.view.rows[2].rate && shipfp.view.rows[2].unit.textContent === 'rpm'")
    low, high = page.evaluate("shipfp.view.rows[2].range")
    assert 1000.0 < low < high < 1400.0
    if folder := os.environ.get("VIEW_SCREENSHOTS"):
        page.screenshot(path=Path(folder) / "view-reload.png")
    assert visit.complaints == []


def test_a_folder_lists_its_logs_trials_and_runs(browser, tug):
    with served(tug) as caller:
        page = browser.new_page()
        page.goto(caller.server.address)
        page.wait_for_selector("body[data-ready]")
        assert page.locator("#logs a").all_inner_texts() == ["hostile.csv", "my.csv"]
        assert page.locator("#trials a").all_inner_texts() == ["TRIAL.toml"]
        assert page.locator("#results .card").count() == 1
        page.locator("#trials a").click()
        page.wait_for_selector("body[data-ready]")
        assert page.title().startswith("TRIAL.toml: my.csv")
        page.close()
