"""The report in a real browser: it draws, zooms, sorts, prints, and calls nobody.

REPORT_SCREENSHOTS=DIR keeps pictures of it at both widths, light and dark.
"""

from __future__ import annotations

import base64
import io
import os
import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib import image

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint, Identifiability
from shipfp_rs.report import write_report
from tests.launch import echo
from tests.report.test_report import repair

HOSTILE = "<script>window.broken = true</script><img src=x onerror='window.broken = true'>"
SPIKE_S = 61.234
DESKTOP, PHONE = {"width": 1280, "height": 900}, {"width": 390, "height": 844}


@pytest.fixture(scope="module")
def report(tmp_path_factory) -> Path:
    """Write the report of two records, one of them with a spike of a single sample and faults at known times."""
    seconds = np.arange(0.0, 120.0, 0.001)
    random = np.random.default_rng(5)
    set_point = 1183.8 + 40.0 * np.sin(0.5 * seconds)
    torque = 1.45 * set_point + random.normal(0.0, 5.0, seconds.size)
    torque[round(1000 * SPIKE_S)] = 3000.0
    torque[80_000:81_000] = np.nan
    clock = {"rate_hz": 2000.0, "start_s": 0.0, "samples": 240_000, "rows": [0, 240_000]}
    experiment = Experiment(
        "S1",
        1000.0,
        {"n_set": set_point, "n_e": set_point + random.normal(0.0, 1.0, seconds.size), "M_g": torque},
        {"n_set": 1183.8, "n_e": 1183.8, "M_g": 1716.5},
        provenance={
            "log": HOSTILE,
            "window_s": [0.0, 120.0],
            "recorded": {"U_set": {**clock, "signal": "n_set"}, HOSTILE: {**clock, "signal": "M_g"}},
            "faults": [
                repair("D2", "U_set", "taken out", [[20_000, 20_100], [40_000, 40_100]], excluded=False),
                repair("C", HOSTILE, "masked", [[160_000, 162_000]]),
            ],
        },
    )
    other = replace(experiment.window(0.0, 30.0, name=HOSTILE), provenance={"unit": HOSTILE})
    fingerprint = Fingerprint(
        parameters={
            "tau_n": Estimate(1.1712, 0.0234, (1.1253, 1.2171), "s"),
            "K_p": Estimate(10.5, 0.2, (10.1, 10.9)),
            "g": Estimate(-0.4, 0.01, (-0.42, -0.38)),
            "v": Estimate(None, status="unidentifiable", reason=HOSTILE),
            "T_d": Estimate(0.0, None, (0.0, 0.02), HOSTILE, "at_bound", "on its lower bound"),
        },
        derived={},
        identifiability=Identifiability(3, 4, np.inf),
        fit={"dn": {"nrmse_pct": 98.8, "whiteness_p": 0.3, "input_correlation_p": 1e-9}},
        residuals={
            "dn": {
                kind: {"lags": [1, 2, 5], "correlation": [0.02, -0.4, 0.01], "band": [0.05, 0.05, 0.05]}
                for kind in ("autocorrelation", "set_point")
            }
        },
        structure={"name": HOSTILE},
        vessel=HOSTILE,
        verdict=(f"Known: tau_n. {HOSTILE}",),
    )
    models = [echo(one) for one in (experiment, other)]
    path = tmp_path_factory.mktemp("report") / "report.html"
    return write_report(path, fingerprint, [experiment, other], simulated=models, title=HOSTILE)


class Visit:
    """An open page, with what it asked of the network and what it complained about."""

    def __init__(self, page, address: str, ready: str = "figure.chart .plot svg") -> None:
        self.page = page
        self.requests: list[str] = []
        self.complaints: list[str] = []
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("console", lambda message: self.complaints.append(message.text))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.goto(address)
        page.wait_for_selector(ready)

    def stretch(self) -> tuple[float, float]:
        """Return what the first chart's status says it shows [s]; the whole record where it says nothing."""
        told = re.findall(r"([\d.]+) s", self.page.locator(".status").first.inner_text())
        return (float(told[0]), float(told[1])) if told else (0.0, 120.0)

    def is_drawn_in(self, scheme: str) -> bool:
        """Whether ink and paper are far apart, the ink brighter where all is dark."""
        ink, paper = (
            sum(
                map(
                    int,
                    re.findall(r"\d+", self.page.evaluate(f"getComputedStyle(document.body).{which}"))[:3],
                )
            )
            for which in ("color", "backgroundColor")
        )
        return (ink > paper) == (scheme == "dark") and abs(ink - paper) > 500


@pytest.fixture(scope="module")
def opened(browser, report):
    """Pages by what they were opened with; each is opened once."""
    pages: dict[str, Visit] = {}

    def open_page(viewport=DESKTOP, **options) -> Visit:
        key = repr((viewport, options))
        if key not in pages:
            pages[key] = Visit(browser.new_page(viewport=viewport, **options), report.as_uri())
        return pages[key]

    yield open_page
    for visit in pages.values():
        visit.page.close()


@pytest.fixture
def visit(opened):
    """A page on a desk that shows all; what a test hides or sorts, it shows again."""
    found = opened()
    found.page.get_by_role("button", name="show all").first.click()
    return found


@pytest.fixture
def still(visit):
    """The same page, looked at and not touched."""
    return visit.page


@pytest.fixture
def spoilt(browser, report):
    """A page of a test's own."""
    page = browser.new_page(viewport=DESKTOP, color_scheme="dark")
    yield Visit(page, report.as_uri()).page
    page.close()


@pytest.mark.parametrize(
    ("viewport", "scheme"), [(DESKTOP, "light"), (PHONE, "dark")], ids=["desktop", "phone"]
)
def test_it_draws_in_either_light_at_either_width_and_calls_nobody(opened, report, viewport, scheme) -> None:
    visit = opened(viewport, color_scheme=scheme)
    page = visit.page
    assert visit.complaints == []
    assert visit.requests == [report.as_uri()]
    assert page.evaluate("document.documentElement.scrollWidth") <= viewport["width"]
    for chart in page.locator("figure.chart").all():
        assert chart.locator("path.series").count() == 7  # three signals, two models, two residuals
        assert all(path.get_attribute("d") for path in chart.locator("path.series").all())
    assert visit.is_drawn_in(scheme)
    if folder := os.environ.get("REPORT_SCREENSHOTS"):
        page.screenshot(path=Path(folder) / f"report-{viewport['width']}-{scheme}.png", full_page=True)


def test_nothing_that_a_log_names_runs_or_becomes_an_element(still) -> None:
    assert still.evaluate("window.broken") is None
    assert still.locator("img").count() == 0
    assert still.locator("body script:not([type])").count() == 3
    assert HOSTILE in still.locator("h1").inner_text()


def series_of(page, index: int) -> str:
    return page.locator("figure.chart").first.locator("path.series").nth(index).get_attribute("d")


def test_the_zoom_obeys_drag_double_click_buttons_and_keys(visit) -> None:
    page, plot = visit.page, visit.page.locator(".plot").first
    before = series_of(page, 0)
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    left, wide = box["x"] + 58, box["width"] - 66
    page.mouse.move(left + 0.25 * wide, box["y"] + 60)
    page.mouse.down()
    page.mouse.move(left + 0.5 * wide, box["y"] + 80, steps=4)
    page.mouse.up()
    assert visit.stretch() == pytest.approx((30.0, 60.0), abs=0.5)
    assert series_of(page, 0) != before
    plot.dblclick(position={"x": 300, "y": 60})
    assert visit.stretch() == (0.0, 120.0)
    assert series_of(page, 0) == before
    page.get_by_role("button", name="zoom in").first.click()
    assert visit.stretch() == (30.0, 90.0)
    page.locator(".plot").first.focus()
    for key, stretch in (
        ("ArrowRight", (45.0, 105.0)),
        ("+", (60.0, 90.0)),
        ("-", (45.0, 105.0)),
        ("Home", (0.0, 60.0)),
        ("End", (60.0, 120.0)),
        ("0", (0.0, 120.0)),
    ):
        page.keyboard.press(key)
        assert visit.stretch() == stretch, key


def test_fault_after_fault_is_shown_by_name(visit) -> None:
    chart = visit.page.locator("figure.chart").first
    assert chart.locator("path.mended").count() == 1
    assert chart.locator("path.cut").count() == 1
    told = []
    for _ in range(4):
        chart.get_by_role("button", name="next fault").click()
        told.append(chart.locator(".status").inner_text())
    places = [float(re.search(r"at ([\d.]+) s", text).group(1)) for text in told]
    assert places == [10.0, 20.0, 80.0, 80.0]
    assert told[0].startswith("mains hum on the set point (D2), U_set: taken out")


def test_a_peak_of_one_sample_among_120000_is_seen_before_the_zoom(still) -> None:
    """The torque's axis reaches the spike, and its path goes there, at its time."""
    chart = still.locator("figure.chart").first
    frame = chart.locator("rect.frame").nth(2)
    left, top, wide = (float(frame.get_attribute(name)) for name in ("x", "y", "width"))
    path = chart.locator("path.series").nth(4).get_attribute("d")
    points = np.array(re.findall(r"[ML](-?[\d.]+) (-?[\d.]+)", path), dtype=float)
    x, y = points[points[:, 1].argmin()]
    assert (x - left) / wide == pytest.approx(SPIKE_S / 120.0, abs=0.003)
    assert y - top < 15
    assert len(points) < 3 * wide  # and yet no more is drawn than can be seen


def test_eight_hours_are_drawn_anew_in_less_time_than_it_took_to_open_them(browser, tmp_path) -> None:
    samples = np.random.default_rng(6).normal(1183.8, 5.0, 2_880_000)
    samples[1_500_000] = 1900.0
    record = Experiment("8 h", 100.0, {"n_set": samples, "n_e": samples}, {"n_set": 1183.8, "n_e": 1183.8})
    bare = Fingerprint({}, {}, Identifiability(0, 0, np.inf), {}, {})
    path = write_report(tmp_path / "report.html", bare, [record])
    page = browser.new_page(viewport=DESKTOP)
    began = time.perf_counter()
    opened = Visit(page, path.as_uri())
    opening = time.perf_counter() - began
    began = time.perf_counter()
    for _ in range(5):
        page.get_by_role("button", name="show all").click()
    redrawing = (time.perf_counter() - began) / 5
    print(f"opening {1e3 * opening:.0f} ms, drawing all of it anew {1e3 * redrawing:.0f} ms")
    assert redrawing < opening
    assert opened.complaints == []
    ticks = [text for text in page.locator(".plot text").all_text_contents() if text.isdigit()]
    assert max(map(int, ticks)) >= 1800  # the axis reaches the one sample that stands out
    page.close()


def test_kinds_of_faults_have_signs_of_their_own_in_plot_and_legend(still) -> None:
    chart = still.locator("figure.chart").first
    plotted = [sign.get_attribute("d") for sign in chart.locator(".plot path.sign").all()]
    assert len(plotted) == 3  # two stretches of hum, one spike
    explained = [sign.get_attribute("d") for sign in chart.locator(".legend .sign path").all()]
    assert len(explained) == len(set(explained)) == 2
    assert list(dict.fromkeys(plotted)) == explained


def test_measurement_model_and_what_is_left_are_told_apart(still) -> None:
    chart = still.locator("figure.chart").first
    asked, measured, model, left = (
        line.evaluate(
            "line => [getComputedStyle(line).stroke, parseFloat(getComputedStyle(line).strokeWidth)]"
        )
        for line in chart.locator("path.series").all()[:4]
    )
    assert len({colour for colour, _ in (asked, measured, model, left)}) == 4
    assert measured[1] > 2.0 * model[1]
    assert measured[0] == "rgb(63, 127, 191)"  # blue, as in the other pictures


def test_a_table_that_goes_on_beyond_the_edge_has_a_shadow_there(opened) -> None:
    page = opened(PHONE).page
    region = page.locator("section[aria-labelledby=parameters] .scroll").first

    def shade() -> tuple[float, float]:
        """Return how dark the region is at its left and right edge, below the text of its last row."""
        path = io.BytesIO(region.screenshot())
        row = image.imread(path)[-6, :, :3].mean(axis=1)
        return float(row[len(row) // 2] - row[2]), float(row[len(row) // 2] - row[-3])

    assert shade()[1] > 0.1
    region.evaluate("box => { box.scrollLeft = box.scrollWidth; }")
    assert shade()[1] < 0.05


def test_on_paper_each_page_repeats_the_heads_of_a_long_table(spoilt) -> None:
    spoilt.locator("section[aria-labelledby=parameters] table").first.evaluate(
        """(table) => {
            table.querySelector("button").innerHTML = '<a href="https://head.invalid">symbol</a>';
            const body = table.tBodies[0], rows = [...body.rows];
            for (let copy = 0; copy < 30; copy++) body.append(...rows.map((row) => row.cloneNode(true)));
        }"""
    )
    printed = spoilt.pdf(format="A4")
    pages = len(re.findall(rb"/Type\s*/Page\b", printed))
    # Chromium notes a link in a table once for each of its pages, and as often again for each repeated head.
    assert printed.count(b"https://head.invalid") > 2 * pages


def test_a_series_is_hidden_by_its_legend(visit) -> None:
    chart = visit.page.locator("figure.chart").first
    entry = chart.get_by_role("button", name="set point n_set")
    entry.click()
    assert entry.get_attribute("aria-pressed") == "false"
    assert chart.locator("path.series").count() == 6
    entry.click()
    assert chart.locator("path.series").count() == 7


def column(page, about: str, index: int) -> list[str]:
    table = page.locator("table", has=page.locator("caption", has_text=about))
    return [row.locator("th, td").nth(index).inner_text() for row in table.locator("tbody tr").all()]


def test_tables_sort_by_size_and_leave_the_empty_last(visit) -> None:
    page = visit.page
    about = "parameters with their 95"
    table = page.locator("table", has=page.locator("caption", has_text=about))
    head = table.get_by_role("button", name="estimate")
    head.click()
    assert column(page, about, 0) == ["g", "T_d", "tau_n", "K_p", "v"]
    assert table.locator("th[aria-sort=ascending]").inner_text().startswith("estimate")
    head.press("Enter")
    assert column(page, about, 0) == ["K_p", "tau_n", "T_d", "g", "v"]


def test_it_can_be_read_aloud_and_walked_through_by_key(spoilt) -> None:
    page = spoilt
    assert page.locator("html").get_attribute("lang") == "en"
    for landmark in ("banner", "main", "navigation"):
        assert page.get_by_role(landmark).count() == 1
    for link in page.locator("nav a").all():
        assert page.locator(f"section > h2{link.get_attribute('href')}").count() == 1
    for named in page.locator("svg[role=img], .plot, [role=region], [role=toolbar]").all():
        assert named.get_attribute("aria-label")
    assert page.locator("table").count() == page.locator("table caption").count()
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"
    reached = set()
    for _ in range(80):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("document.activeElement.closest('.plot, .toolbar, thead, nav')?.className"))
    assert {"plot", "toolbar"} <= reached


def test_the_residuals_correlogram_is_told_in_words_and_fits_the_page(opened) -> None:
    page = opened(PHONE).page
    page.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = false; })")
    page.locator("section[aria-labelledby=statistics] summary").first.click()
    figure = page.locator("section[aria-labelledby=statistics] figure")
    assert figure.count() == 1
    told = figure.locator("svg[role=img]").get_attribute("aria-label")
    assert "their own past, 1 of 3 lags outside the band" in told
    assert figure.locator("figcaption").inner_text() == f"{told} PNG CSV"
    page.keyboard.press("End")
    region = figure.get_by_role("region")
    assert region.evaluate("box => box.scrollWidth > box.clientWidth && box.tabIndex === 0")  # a key moves it


def test_it_prints_with_its_plots_without_its_buttons_and_in_ink_on_white(spoilt) -> None:
    page = spoilt
    drawn = "document.querySelector('.plot svg').getAttribute('viewBox')"
    page.evaluate(f"addEventListener('beforeprint', () => {{ window.drawn = {drawn} }})")
    printed = page.pdf(format="A4", print_background=True)
    assert page.evaluate("window.drawn").startswith("0 0 690 ")  # anew, for the width of the paper
    assert printed.startswith(b"%PDF")
    assert 3 <= len(re.findall(rb"/Type\s*/Page\b", printed)) <= 30
    page.emulate_media(media="print")
    assert not page.locator(".toolbar").first.is_visible()
    assert page.locator(".plot svg").first.is_visible()
    assert page.locator("details table").first.is_visible()  # no one can unfold paper
    assert not page.locator("details pre").first.is_visible()  # settings, for a program to read
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    page.set_viewport_size({"width": 700, "height": 1000})  # A4 less its margins
    assert page.evaluate("document.documentElement.scrollWidth") <= 700


def test_without_scripts_there_is_a_still_picture_of_the_first_record(browser, report) -> None:
    page = browser.new_page(java_script_enabled=False)
    page.goto(report.as_uri())
    assert page.locator("noscript svg[role=img]").count() == 1
    assert page.locator("noscript svg").first.is_visible()
    assert not page.locator("a[data-picture]").first.is_visible()  # what only a script can make
    page.close()


def test_what_the_zoom_shows_is_saved_as_csv(visit, tmp_path) -> None:
    page = visit.page
    page.get_by_role("button", name="zoom in").first.click()
    with page.expect_download() as waiting:
        page.get_by_role("button", name="save as CSV").first.click()
    saved = tmp_path / "signals.csv"
    waiting.value.save_as(saved)
    head, *rows = saved.read_text(encoding="utf-8").splitlines()
    assert head.startswith('"time [s]","set point n_set","speed n_e","model of n_e"')
    assert len(rows) == 60_000  # 30 to 90 s at 1 kHz
    assert [float(cell) for cell in rows[0].split(",")[:2]] == pytest.approx(
        [30.0, 1183.8 + 40.0 * np.sin(15.0)], abs=0.01
    )


def test_estimates_and_pictures_are_saved_from_the_page_itself(visit, tmp_path) -> None:
    page = visit.page
    for name, begins in (
        ("These figures as CSV", b"symbol,name,value"),
        ("PNG", b"\x89PNG"),
        ("CSV", b"time_s,n_set_rpm,n_e_rpm,n_e_model,M_g_Nm,M_g_model\n"),
    ):
        with page.expect_download() as waiting:
            page.get_by_role("link", name=name, exact=True).first.click()
        waiting.value.save_as(tmp_path / "saved")
        assert (tmp_path / "saved").read_bytes().startswith(begins)


def test_a_still_picture_is_saved_as_it_is_printed(opened, tmp_path) -> None:
    page = opened(PHONE, color_scheme="dark").page
    with page.expect_download() as waiting:
        page.get_by_role("link", name="PNG", exact=True).first.click()
    assert waiting.value.suggested_filename == "picture-1.png"
    waiting.value.save_as(tmp_path / "still.png")
    pixels = image.imread(tmp_path / "still.png")[..., :3]
    assert (pixels[0, 0] == 1.0).all()  # white
    assert pixels.shape[1] > 800
    assert 0.002 < (pixels.max(axis=2) < 0.3).mean() < 0.2  # ink: axes and their labels
    assert (np.ptp(pixels, axis=2) > 0.2).mean() > 0.005  # curves


def test_rows_are_not_stretched_by_narrow_columns_on_a_phone(opened) -> None:
    page = opened(PHONE).page
    page.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    tall = page.evaluate(
        """() => [...document.querySelectorAll("table.sortable tbody tr")].filter((row) =>
            row.getBoundingClientRect().height > 80 && [...row.cells].every((cell) => cell.innerText.length < 60)
        ).map((row) => row.innerText)"""
    )
    assert tall == []


def test_nothing_of_a_still_picture_is_cut(visit) -> None:
    page = visit.page
    page.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    cut = page.evaluate(
        """() => [...document.querySelectorAll("figure:not(.chart) svg")].flatMap((svg) => {
            const box = svg.getBoundingClientRect();
            return [...svg.querySelectorAll("g[id*=text], g[id*=tick], g[id*=legend]")].filter((part) => {
                const own = part.getBoundingClientRect();
                const beside = own.left < box.left || own.right > box.right;
                return own.width && (beside || own.top < box.top || own.bottom > box.bottom);
            }).map((part) => part.id);
        })"""
    )
    assert cut == []


def test_every_picture_has_what_it_shows_as_csv(still) -> None:
    figures = still.locator("figure:not(.chart)")
    assert figures.count() >= 3
    for place in range(figures.count()):
        address = figures.nth(place).locator('a[download$=".csv"]').get_attribute("href")
        head, *rows = base64.b64decode(address.split(",")[1]).decode().splitlines()
        assert head.count(",") >= 2
        assert len(rows) >= 3
        assert all(row.count(",") == head.count(",") for row in rows if '"' not in row)
