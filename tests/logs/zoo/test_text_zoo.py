"""Text logs as people export them: each is read to the samples, units and times it was made of, or refused in one line."""

import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.logs.log import Log

ROWS = 40
RATE_HZ = 20.0
START = datetime(2019, 11, 5, 10, 0, 0, tzinfo=UTC)
TORQUE = np.round(1500.0 + 400.0 * np.sin(np.arange(ROWS) / 5.0), 3)
SPEED = np.round(1184.25 + np.arange(ROWS) / 4.0, 2)
SECONDS = np.arange(ROWS) / RATE_HZ


@dataclass(frozen=True)
class Layout:
    """A text file and what is true of it.

    Parameters
    ----------
    name
        What is special about it.
    content
        Bytes of the file.
    suffix, rate_hz, time
        Of the file, and options of `Log.open`.
    start_s, start_utc
        Times of the first sample; None: not told.
    within_s
        How well they are known.
    torque, speed
        Names of the channels.
    units
        Theirs.
    rate
        Sample rate of the log [Hz].
    says
        Words that a note or a warning must hold.
    refused
        Words of the one line by which the file is refused.
    """

    name: str
    content: bytes
    suffix: str = ".csv"
    rate_hz: float | None = None
    time: str | None = None
    start_s: float | None = 0.0
    start_utc: datetime | None = None
    within_s: float = 1e-6
    torque: str = "M"
    speed: str = "n"
    units: tuple[str, str] = ("Nm", "rpm")
    rate: float = RATE_HZ
    says: str = ""
    refused: str = ""


def number(value: float, decimal: str = ".", thousands: str = "", digits: int = 3) -> str:
    text = f"{value:,.{digits}f}" if thousands else f"{value:.{digits}f}"
    return text.replace(",", "\0").replace(".", decimal).replace("\0", thousands)


def stamps(form: Callable[[datetime], str], start: datetime = START) -> list[str]:
    return [form(start + timedelta(seconds=float(s))) for s in SECONDS]


def fraction(time: datetime, digits: int = 3) -> str:
    return f"{time.microsecond:06d}"[:digits]


def table(
    head: Sequence[str] | str,
    *columns: Iterable[str],
    sep: str = ",",
    decimal: str = ".",
    thousands: str = "",
    quote: bool = False,
    end: str = "\n",
    before: str = "",
    after: str = "",
    last: str = "",
) -> str:
    """Write lines: what stands before, headings, times, torque and speed, what stands after."""
    torque = [number(value, decimal, thousands) for value in TORQUE]
    speed = [number(value, decimal, thousands, 2) for value in SPEED]
    rows = zip(*columns, torque, speed, strict=True)
    lines = [head] if isinstance(head, str) else list(head)
    lines += [sep.join(f'"{cell}"' if quote else cell for cell in row) + last for row in rows]
    return before + end.join(lines) + end + after


def seconds(decimal: str = ".", factor: float = 1.0, digits: int = 2, start: float = 0.0) -> list[str]:
    return [number(start + s * factor, decimal, digits=digits) for s in SECONDS]


def _names() -> list[Layout]:
    """Headings of time in ten languages, units in any bracket, and units of speed."""
    found = [
        Layout(f"heading {heading!r}", table(f"{heading},M [Nm],n [rpm]", seconds()).encode())
        for heading in (
            "time", "Time (s)", "Elapsed time [s]", "Time s", "t{s}", "t <s>", "time_s", "TIME", "X_Value",
            "X-Value [s]", "Zeit [s]", "Messzeit [Sek]", "Tijd (sec)", "Temps [s]", "Temps écoulé (s)", "Tid [s]", "Tid [sek]",
            "Tiempo (seg)", "Tempo [s]", "Czas [s]", "Aika [s]", "Zaman [s]", "Время [с]", "时间 [s]", "Seconds", "Sekunden",
            "Timestamp", "time / s", "t in s",
        )
    ]  # fmt: skip
    found += [
        Layout(f"speed in {unit}", table(f"time [s],M [Nm],n [{unit}]", seconds()).encode("utf-8"))
        for unit in ("U/min", "1/min", "min-1", "min⁻¹", "RPM", "r/min", "omw/min", "tr/min", "varv/min", "giri/min", "obr/min",
                     "об/мин", "o/min")
    ]  # fmt: skip
    found += [
        Layout(
            f"torque in {unit}, {code}",
            table(f"time [s];M [{unit}];n [rpm]", seconds(), sep=";").encode(code),
        )
        for unit, code in (("N·m", "utf-8"), ("N*m", "utf-8"), ("N·m", "latin-1"))
    ]
    found += [
        Layout(
            "heading 'Time [ms]'", table("Time [ms],M [Nm],n [rpm]", seconds(factor=1e3, digits=0)).encode()
        ),
        Layout("heading 'time_us'", table("time_us,M [Nm],n [rpm]", seconds(factor=1e6, digits=0)).encode()),
        Layout(
            "heading 'Zeit [min]'",
            table("Zeit [min],M [Nm],n [rpm]", seconds(factor=1 / 60, digits=9)).encode(),
            within_s=1e-5,
        ),
        Layout("units in Latin-1 mis-coded", table("time [s],M [Nm],n [rpm]", seconds()).encode()),
        Layout("slashed units", table("t / s;M / Nm;n / U/min", seconds(","), sep=";", decimal=",").encode()),
        Layout(
            "n in 1/min", table("Zeit in s;M in Nm;n in 1/min", seconds(","), sep=";", decimal=",").encode()
        ),
    ]
    return found


def _marks() -> list[Layout]:
    """Separators, decimal marks, thousands, encodings, line ends, preambles, footers."""
    plain = "time [s],M [Nm],n [rpm]"
    german = "Zeit [s];M [Nm];n [U/min]"
    return [
        Layout("quoted thousands 1.184,00", table(german, seconds(","), sep=";", decimal=",", thousands=".", quote=True).encode()),
        Layout("bare thousands 1.184,00", table(german, seconds(","), sep=";", decimal=",", thousands=".").encode()),
        Layout('quoted thousands 1,184.00', table(plain, seconds(), thousands=",", quote=True).encode()),
        Layout("thousands by spaces", table(german, seconds(","), sep=";", decimal=",", thousands="\u202f").encode()),
        Layout("thousands by hard spaces", table(german, seconds(","), sep=";", decimal=",", thousands="\u00a0").encode("latin-1")),
        Layout("thousands by apostrophes", table(german, seconds(), sep=";", thousands="'").encode()),
        Layout("decimal commas in quotes", table('"time [s]","M [Nm]","n [rpm]"', seconds(","), decimal=",", quote=True).encode()),
        Layout("UTF-16", table(german, seconds(","), sep=";", decimal=",").encode("utf-16")),
        Layout("UTF-16 big endian", b"\xfe\xff" + table(plain, seconds()).encode("utf-16-be")),
        Layout("UTF-16 without mark", table(plain.replace(",", "\t"), seconds(), sep="\t").encode("utf-16-le"), suffix=".txt"),
        Layout("UTF-8 with mark", table(plain, seconds()).encode("utf-8-sig")),
        Layout("line ends of Windows", table(plain, seconds(), end="\r\n").encode()),
        Layout("line ends of CR alone", table(plain, seconds(), end="\r").encode()),
        Layout("quoted headings alone", table('"time [s]","M [Nm]","n [rpm]"', seconds()).encode()),
        Layout("tabs and commas", table("Tijd [s]\tM [Nm]\tn [omw/min]", seconds(","), sep="\t", decimal=",").encode(), suffix=".txt"),
        Layout("columns of spaces", table("time    M       n\n[s]     [Nm]    [rpm]", [f"  {s}" for s in seconds()], sep="     ").encode(), suffix=".txt"),
        Layout("suffix .dat", table(plain.replace(",", "\t"), seconds(), sep="\t").encode(), suffix=".dat"),
        Layout("suffix .tsv", table(plain.replace(",", "\t"), seconds(), sep="\t").encode(), suffix=".tsv"),
        Layout("bars", table("time [s]|M [Nm]|n [rpm]", seconds(), sep="|").encode()),
        Layout("a mark at every end", table("time [s];M [Nm];n [rpm];", seconds(","), sep=";", decimal=",", last=";").encode()),
        Layout("a mark behind records only", table("time [s];M [Nm];n [rpm]", seconds(","), sep=";", decimal=",", last=";").encode()),
        Layout("blanks behind commas", table("time [s], M [Nm], n [rpm]", seconds(), sep=", ").encode()),
        Layout("units row", table(["Zeit;M;n", "s;Nm;U/min"], seconds(","), sep=";", decimal=",").encode()),
        Layout("units row in brackets", table(["Zeit;M;n", "[s];[Nm];[1/min]"], seconds(","), sep=";", decimal=",").encode()),
        Layout("units row and description", table(["Zeit;M;n", "s;Nm;1/min", "time base;torque at flange;engine"], seconds(","), sep=";", decimal=",").encode()),
        Layout("units row with hh:mm:ss", table(["Zeit;M;n", "hh:mm:ss;Nm;U/min"], stamps(lambda t: f"{t:%H:%M:%S},{fraction(t)}"), sep=";", decimal=",").encode(), start_s=36000.0),
        Layout("PicoScope", table(["Time,M,n", "(ms),(Nm),(rpm)", ""], seconds(factor=1e3)).encode()),
        Layout("LabVIEW", table("X_Value\tM\tn\tComment", seconds(), sep="\t", before="LabVIEW Measurement\nWriter_Version\t2\nSeparator\tTab\nDelta_X\t0.05\n***End_of_Header***\t\n", last="\t").encode(), suffix=".lvm", units=("", "")),
        Layout("preamble", table(german, seconds(","), sep=";", decimal=",", before="Messung 7\nSchiff: Tug 1205, Pfahlzug\nMesser;J. Smith\nOrt: Den Helder; 05.11.2019\n\n").encode()),
        Layout("preamble of comments", table("# time [s],M [Nm],n [rpm]", seconds(), before="# Trial 7\n# J. Smith\n").encode()),
        Layout("preamble in percents", table("% time [s],M [Nm],n [rpm]", seconds(), before="% Octave\n").encode(), suffix=".txt"),
        Layout("Excel's separator line", table(german, seconds(","), sep=";", decimal=",", before="sep=;\n").encode()),
        Layout("rate in the preamble", table("M [Nm];n [rpm]", sep=";", before="Abtastrate: 20 Hz\n\n").encode()),
        Layout("rate in French", table("M [Nm];n [tr/min]", sep=";", before="Fréquence d'échantillonnage [Hz];20\n").encode()),
        Layout("rate in English", table("M [Nm],n [rpm]", before="Sample rate: 20 Hz\n").encode()),
        Layout("rate in kHz above a row of units", table(["M;n", "Nm;rpm"], sep=";", decimal=",", before="Sample rate [kHz];0,02\nChannels;2\n").encode()),
        Layout("interval as dt", table("M [Nm],n [rpm]", before="dt = 50 ms\n").encode()),
        Layout("interval in the preamble", table("M [Nm],n [rpm]", before="Sample interval = 50 ms\n").encode()),
        Layout("footer", table(plain, seconds(), after="End of data\n").encode(), says="1 lines after the last record"),
        Layout("footer with figures", table(plain, seconds(), after="\nMax,1899.9,1194\nMin,1100.1,1184\n").encode(), says="lines after the last record"),
        Layout("footer without an end", table(plain, seconds(), after="*** logger stopped ***").encode(), says="after the last record"),
        Layout("column of words", table("time [s],M [Nm],n [rpm],state", seconds(), last=",on").encode(), says="no numbers in state"),
        Layout("empty column", table("time [s],M [Nm],n [rpm],", seconds(), last=",").encode()),
        Layout("rate given", table("M [Nm],n [rpm]").encode(), rate_hz=20.0),
        Layout("no headings", table("x", seconds()).split("\n", 1)[1].encode(), torque="column 2", speed="column 3", units=("", ""), says="taken as time"),
        Layout("no headings, one space", table("x", seconds(), sep=" ").split("\n", 1)[1].encode(), suffix=".txt", torque="column 2", speed="column 3", units=("", ""), says="taken as time"),
        Layout("no headings, date and time", table("x", stamps(lambda t: f"{t:%d.%m.%Y}"), stamps(lambda t: f"{t:%H:%M:%S}.{fraction(t)}"), sep=";").split("\n", 1)[1].encode(), torque="column 3", speed="column 4", units=("", ""), start_utc=START),
    ]  # fmt: skip


def _stamps() -> list[Layout]:
    """Dates and times as countries and programs write them."""
    forms: dict[str, tuple[Callable[[datetime], str], str]] = {
        "ISO": (lambda t: f"{t:%Y-%m-%dT%H:%M:%S}.{fraction(t)}Z", ","),
        "ISO with a zone": (lambda t: f"{t + timedelta(hours=1):%Y-%m-%d %H:%M:%S}.{fraction(t)}+01:00", ","),
        "German": (lambda t: f"{t:%d.%m.%Y %H:%M:%S}.{fraction(t)}", ";"),
        "German, decimal comma": (lambda t: f"{t:%d.%m.%Y %H:%M:%S},{fraction(t, 6)}", ";"),
        "German, short year": (lambda t: f"{t:%d.%m.%y %H:%M:%S}.{fraction(t)}", ";"),
        "colon before milliseconds": (lambda t: f"{t:%d.%m.%Y %H:%M:%S}:{fraction(t)}", ";"),
        "Dutch": (lambda t: f"{t.day}-{t.month}-{t.year} {t:%H:%M:%S}.{fraction(t)}", ";"),
        "English": (lambda t: f"{t:%d/%m/%Y %H:%M:%S}.{fraction(t)}", ";"),
        "American": (lambda t: f"{t.month}/{t.day}/{t.year} {t:%I:%M:%S}.{fraction(t)} {t:%p}", ","),
        "am and pm with dots": (
            lambda t: f"{t:%Y/%m/%d %I:%M:%S}.{fraction(t)} " + ("a.m." if t.hour < 12 else "p.m."),
            ",",
        ),
        "MATLAB": (lambda t: f"{t:%d-%b-%Y %H:%M:%S}.{fraction(t)}", ","),
        "month in words": (lambda t: f"{t:%b %d, %Y %I:%M:%S}.{fraction(t)} {t:%p}", ";"),
        "German month": (lambda t: f"{t.day}. November {t.year} {t:%H:%M:%S},{fraction(t)}", ";"),
        "compact": (lambda t: f"{t:%Y%m%dT%H%M%S}.{fraction(t)}", ","),
        "year first with slashes": (lambda t: f"{t:%Y/%m/%d %H:%M:%S}.{fraction(t)}", ","),
    }
    found = [
        Layout(
            f"stamps: {name}",
            table(f"Timestamp{sep}M [Nm]{sep}n [rpm]", stamps(form), sep=sep, decimal="," if "comma" in name or ("month" in name[:13] and sep == ";" and "German" in name) else ".").encode(),
            start_utc=START,
        )
        for name, (form, sep) in forms.items()
    ]  # fmt: skip
    night = datetime(2019, 11, 5, 23, 59, 59, tzinfo=UTC)
    pairs = {
        "Datum;Uhrzeit": (stamps(lambda t: f"{t:%d.%m.%Y}"), stamps(lambda t: f"{t:%H:%M:%S},{fraction(t)}")),
        "Date;Time": (stamps(lambda t: f"{t:%Y-%m-%d}"), stamps(lambda t: f"{t:%H:%M:%S}.{fraction(t)}")),
        "Date;Heure": (stamps(lambda t: f"{t:%d/%m/%Y}"), stamps(lambda t: f"{t:%H:%M:%S}.{fraction(t)}")),
        "Date;Time [AM/PM]": (
            stamps(lambda t: f"{t:%m/%d/%Y}"),
            stamps(lambda t: f"{t:%I:%M:%S}.{fraction(t)} {t:%p}"),
        ),
        "Fecha;Hora": (stamps(lambda t: f"{t:%d-%m-%Y}"), stamps(lambda t: f"{t:%H:%M:%S}.{fraction(t)}")),
        "Datum;Tijd": (stamps(lambda t: f"{t:%Y%m%d}"), stamps(lambda t: f"{t:%H:%M:%S}.{fraction(t)}")),
    }
    found += [
        Layout(
            f"two columns: {head}",
            table(
                f"{head};M [Nm];n [rpm]", *both, sep=";", decimal="," if head == "Datum;Uhrzeit" else "."
            ).encode(),
            start_utc=START,
            time="Date [m/d/y] + Time" if "AM/PM" in head else None,
            says="" if "AM/PM" not in head else "month first",
        )
        for head, both in pairs.items()
    ]
    clock = stamps(lambda t: f"{t:%H:%M:%S}.{fraction(t)}")
    found += [
        Layout("time of day", table("Time,M [Nm],n [rpm]", clock).encode(), start_s=36000.0, says="without a date"),
        Layout("time of day, short", table("Time,M [Nm],n [rpm]", stamps(lambda t: f"{t.hour}:{t:%M:%S}.{fraction(t, 2)}")).encode(), start_s=36000.0),
        Layout("midnight", table("Uhrzeit;M [Nm];n [rpm]", stamps(lambda t: f"{t:%H:%M:%S}.{fraction(t)}", night), sep=";").encode(), start_s=86399.0),
        Layout("midnight with AM and PM", table("Time,M [Nm],n [rpm]", stamps(lambda t: f"{t:%I:%M:%S}.{fraction(t)} {t:%p}", night)).encode(), start_s=86399.0),
        Layout("midnight with dates", table("Date,Time,M [Nm],n [rpm]", stamps(lambda t: f"{t:%d/%m/%Y}", night), stamps(lambda t: f"{t:%H:%M:%S}.{fraction(t)}", night)).encode(), start_utc=night, says="day first"),
        Layout("minutes and seconds", table("Time [mm:ss],M [Nm],n [rpm]", stamps(lambda t: f"{t:%M:%S}.{fraction(t)}")).encode()),
        Layout("elapsed over a day", table("Elapsed,M [Nm],n [rpm]", [f"{100 + int(s) // 3600}:00:{s:06.3f}" for s in SECONDS]).encode(), start_s=360000.0),
        Layout("stamps of tenths of seconds", table("Time,M [Nm],n [rpm]", stamps(lambda t: f"{t:%H:%M:%S}.{fraction(t, 1)}")).encode(), start_s=36000.0, within_s=0.06, says="one time for several rows"),
        Layout("whole seconds and elapsed time", table("Time,Elapsed [s],M [Nm],n [rpm]", stamps(lambda t: f"{t:%Y-%m-%d %H:%M:%S}"), seconds()).encode(), start_utc=START, says="'Time' not used"),
        Layout("sample count beside the time", table("No,Time [s],M [Nm],n [rpm]", [str(k) for k in range(ROWS)], seconds()).encode()),
        Layout("time in the middle", "\n".join(["M [Nm],Time [s],n [rpm]", *(f"{m},{s:.2f},{n}" for m, s, n in zip(TORQUE, SECONDS, SPEED, strict=True)), ""]).encode()),
        Layout("a time for each channel", "\n".join(["Time [s],M [Nm],Time [s],n [rpm]", *(f"{s:.2f},{m},{s + 0.01:.2f},{n}" for m, s, n in zip(TORQUE, SECONDS, SPEED, strict=True)), ""]).encode()),
        Layout("month first, told", table("Stamp,M [Nm],n [rpm]", stamps(lambda t: f"{t:%m/%d/%Y %H:%M:%S}.{fraction(t)}")).encode(), time="Stamp [m/d/y]", start_utc=START),
        Layout("day first by custom", table("Stamp,M [Nm],n [rpm]", stamps(lambda t: f"{t:%d/%m/%Y %H:%M:%S}.{fraction(t)}")).encode(), start_utc=START, says="say --time 'Stamp [m/d/y]'"),
        Layout("month first by its days", table("Stamp,M [Nm],n [rpm]", stamps(lambda t: f"{t:%m/%d/%Y %H:%M:%S}.{fraction(t)}", START + timedelta(days=20))).encode(), start_utc=START + timedelta(days=20), says="month first"),
    ]  # fmt: skip
    return found


def _epochs() -> list[Layout]:
    """Numbers that count from a year."""
    unix = START.timestamp()
    since = {
        "s since 1970": (unix, 1.0, 2, ""),
        "ms since 1970": (unix * 1e3, 1e3, 0, ""),
        "us since 1970": (unix * 1e6, 1e6, 0, ""),
        "ns since 1970": (unix * 1e9, 1e9, 0, ""),
        "s since 1904": (unix + 2082844800, 1.0, 2, ""),
        "100 ns since 1601": ((unix + 11644473600) * 1e7, 1e7, 0, ""),
        "days since 1900": (unix / 86400 + 25569, 1 / 86400, 12, ""),
        "days since year 0": (unix / 86400 + 719529, 1 / 86400, 12, ""),
        "ms since 1970 under [s]": (unix * 1e3, 1e3, 0, " [s]"),
        "ms since 1970 under [ms]": (unix * 1e3, 1e3, 0, " [ms]"),
    }
    found = []
    for name, (first, factor, digits, unit) in since.items():
        if digits:
            cells = [f"{first + s * factor:.{digits}f}" for s in SECONDS]
        else:
            cells = [str(int(first) + round(s * factor)) for s in SECONDS]
        within = 2e-3 if "year 0" in name else 2e-4 if "days" in name else 1e-6
        said = name.partition(" under")[0]
        found.append(
            Layout(
                name,
                table(f"Timestamp{unit},M [Nm],n [rpm]", cells).encode(),
                start_utc=START,
                within_s=within,
                says=said,
            )
        )
    return found


def _wishes() -> list[Layout]:
    """Time columns that only the user knows."""
    cells = [str(round(s * 1e3)) for s in SECONDS]
    return [
        Layout("wish: a column of another name", table("foo,M [Nm],n [rpm]", seconds()).encode(), time="foo"),
        Layout("wish: a unit", table("foo,M [Nm],n [rpm]", cells).encode(), time="foo [ms]"),
        Layout("wish: against the unit of the heading", table("Time [s],M [Nm],n [rpm]", cells).encode(), time="Time [ms]"),
        Layout("wish: the other one of two", table("Time [s],T2,M [Nm],n [rpm]", [f"{7 * k}" for k in range(ROWS)], seconds()).encode(), time="T2 [s]"),
        Layout("wish: a date and a clock", table("A;B;M [Nm];n [rpm]", stamps(lambda t: f"{t:%d.%m.%Y}"), stamps(lambda t: f"{t:%H:%M:%S}.{fraction(t)}"), sep=";").encode(), time="A + B", start_utc=START),
        Layout("wish: no such column", table("foo,M [Nm],n [rpm]", seconds()).encode(), time="bar", refused="time column 'bar', found foo, M, n"),
        Layout("wish: no such unit", table("foo,M [Nm],n [rpm]", seconds()).encode(), time="foo [kg]", refused="expected a unit"),
        Layout("wish: words", table("state,M [Nm],n [rpm]", ["on"] * ROWS).encode(), time="state", refused="holds 'on', expected numbers, or a date"),
        Layout("no time at all", table("M [Nm],n [rpm]").encode(), refused="name the column of time (--time)"),
        Layout("a count of rows without headings", table("x", [str(k) for k in range(ROWS)]).split("\n", 1)[1].encode(), refused="give rate_hz (--rate)"),
        Layout("a time in steps of 50 without a unit", table("Time,M [Nm],n [rpm]", cells).encode(), refused="give its unit, such as --time 'Time [ms]'"),
        Layout("microseconds of a running clock", table("timestamp,M [Nm],n [rpm]", [str(1_200_000_000 + round(s * 1e6)) for s in SECONDS]).encode(), refused="s since 1970, or in another unit? give the unit"),
        Layout("time that goes back often", table("Time,M [Nm],n [rpm]", [str(k % 7) for k in range(ROWS)]).encode(), refused="goes back at row 8: 0 s after 6 s, and in 5 of 40 rows; cut the file there, or give rate_hz (--rate)"),
        Layout("one time for all rows", table("Time,M [Nm],n [rpm]", ["5.0"] * ROWS).encode(), refused="does not increase"),
        Layout("a date that is none", table("Stamp;M [Nm];n [rpm]", ["45.13.2019 10:00:00"] * ROWS, sep=";").encode(), refused="Stamp"),
        Layout("words only", b"on;off\nyes;no\n", refused="lines of numbers"),
    ]  # fmt: skip


LAYOUTS: tuple[Layout, ...] = (*_names(), *_marks(), *_stamps(), *_epochs(), *_wishes())


def test_the_zoo_is_large() -> None:
    assert len(LAYOUTS) >= 80
    assert len({layout.name for layout in LAYOUTS}) == len(LAYOUTS)


@pytest.mark.parametrize("layout", LAYOUTS, ids=[layout.name for layout in LAYOUTS])
def test_breakage_c4_text_layouts(layout: Layout, tmp_path: Path) -> None:
    path = tmp_path / f"log{layout.suffix}"
    path.write_bytes(layout.content)
    if layout.refused:
        with pytest.raises(InputError) as caught:
            Log.open(path, rate_hz=layout.rate_hz, time=layout.time)
        assert layout.refused in str(caught.value)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)
        return
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        log = Log.open(path, rate_hz=layout.rate_hz, time=layout.time)
    said = " | ".join([*log.notes, *(str(warning.message) for warning in told)])
    assert layout.says in said
    np.testing.assert_allclose(log.read(layout.torque), TORQUE, rtol=1e-12)
    np.testing.assert_allclose(log.read(layout.speed), SPEED, rtol=1e-12)
    channel, speed = log.channels[layout.torque], log.channels[layout.speed]
    assert (channel.unit, speed.unit) == layout.units
    assert channel.rate_hz == pytest.approx(layout.rate, rel=2e-3 if layout.within_s > 1e-5 else 1e-6)
    if layout.start_utc is not None:
        assert log.start_utc is not None
        first = (log.start_utc - layout.start_utc).total_seconds() + channel.start_s
        assert first == pytest.approx(0.0, abs=max(layout.within_s, 2e-6))
    elif layout.start_s is not None:
        assert channel.start_s == pytest.approx(layout.start_s, abs=layout.within_s)
        assert log.start_utc is None or abs((log.start_utc - START).total_seconds()) < 1.0
