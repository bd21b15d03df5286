"""Names that loggers use for time, date, clock, units of time and sample rate, in ten languages and more."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable

import numpy as np

from shipfp_rs.support import units

TIMES_TEXT = """
time t timestamp timestamps datetime dateandtime elapsedtime elapsed abstime abstimestamp reltime
relativetime absolutetime measurementtime recordingtime logtime logtimestamp systemtime localtime
utctime utc gpstime testtime runtime simtime simulationtime timeaxis timeseconds timesec seconds
secs sec samplingtime epoch unix unixtime posix unixtimestamp xvalue x xaxis xtime xwert xdata
xvalues timechannel mastertime tsec ts tms tus stamp clock zeit zeitstempel messzeit zeitpunkt
zeitachse abtastzeit relativzeit relzeit abszeit absolutzeit uhrzeit datumzeit datumuhrzeit sekunden
laufzeit zeitkanal tijd tijdstip tijdstempel tijdas meettijd looptijd seconden datumtijd datumentijd
klok temps tempsécoulé heure horodatage horodate dateheure dateetheure instant secondes tempsrelatif
tid tidspunkt tidsstempel tidsstämpel tidstempel tidpunkt forløbettid klokkeslæt klokkeslett
klockslag sekunder datotid tiempo hora marcadetiempo fechahora fechayhora segundos
tiempotranscurrido tempo ora dataora datahora dataeora segundosdecorridos secondi carimbodetempo
tempotrascorso czas godzina datagodzina czaspomiaru sekundy znacznikczasu aika kellonaika aikaleima
sekuntia zaman saat süre zamandamgası время часы датавремя χρόνος ώρα 时间 時間 時刻 时刻 시간
"""
WORDS = frozenset(TIMES_TEXT.split())
"""Column names for time alone or date and time, in lower case without spaces and punctuation."""
DATES_TEXT = """
date datum dato fecha data pvm päivä päivämäärä tarih дата ημερομηνία 日期 日付 날짜 day recorddate
measurementdate messdatum meetdatum utcdate localdate
"""
DATES = frozenset(DATES_TEXT.split())
"""Column names for dates."""
UNITS_TEXT = {
    1.0: "s sec secs second seconds sek sekunde sekunden seconde seconden secondes "
    " seg segundo segundos secondi secondo sekund sekunder sekundy sekunti sekuntia saniye с сек δ 秒 초",
    1e-3: "ms msec millis millisecond milliseconds millisekunden milliseconden мс 毫秒",
    1e-6: "us µs μs usec micros microsecond microseconds mikrosekunden 微秒",
    1e-9: "ns nsec nanosecond nanoseconds nanosekunden",
    60.0: "min mins minute minutes minuten minuti minutos minuter",
    3600.0: "h hr hrs hour hours std stunde stunden uur uren heure heures hora horas ore timer",
    86400.0: "d day days tag tage dag dagen",
}
SECONDS = {"": 1.0} | {word: factor for factor, text in UNITS_TEXT.items() for word in text.split()}
"""Seconds per unit of time, by name in lower case."""
RATES_TEXT = """
rate_hz fs sample_rate samplerate sampling_rate sample_frequency sampling_frequency sampling
samples_per_second sps scan_rate logging_rate log_rate abtastrate abtastfrequenz messrate
samplefrequentie bemonsteringsfrequentie fréquence_d'échantillonnage fréquence_échantillonnage
samplingsfrekvens samplingsfrekvensen punktavläsningsfrekvens frecuencia_de_muestreo
frequência_de_amostragem frequenza_di_campionamento częstotliwość_próbkowania näytteenottotaajuus
örnekleme_frekansı частота_дискретизации
"""
RATE_NAMES = frozenset(RATES_TEXT.split())
INTERVALS_TEXT = """
dt ts delta_x deltax sample_interval sampling_interval sample_period sampling_period sample_time
interval wf_increment abtastintervall abtastzeit abtastperiode periode_d'échantillonnage
período_de_muestreo tinc hresolution increment xincrement x_increment xinc
"""
INTERVAL_NAMES = frozenset(INTERVALS_TEXT.split())
"""Names of a sample rate [Hz] or a sample interval [s], in lower case with underscores."""

BRACKETED = re.compile(r"(.*\S)\s*(?:\[([^\]]*)\]|\(([^)]*)\)|\{([^}]*)\}|<([^>]*)>)\s*")
TAILS = tuple(
    re.compile(pattern)
    for pattern in (
        r"(.*\S)\s+in\s+(\S+)",
        r"(.*?\S)\s*/\s*(.+)",
        r"(.*\S)\s*[,;:]\s*(\S+)",
        r"(.*\S)\s+-\s+(\S+)",
    )
)
UNDERSCORED = re.compile(r"(.*[^\W_])[ _.]+([a-zµμ]+)")


def split_unit(heading: str) -> tuple[str, str]:
    """Split a heading into name and unit at any usual separator: "torque [V]", "n (1/min)", "t / s", "M in Nm".

    After a slash, a comma or "in" only a known unit counts; after an underscore only a unit of time after a word for time.

    Examples
    --------
    >>> [split_unit(text) for text in ("torque [V]", "n / U/min", "Date/Time", "time_ms", "rate_hz")]
    [('torque', 'V'), ('n', 'rpm'), ('Date/Time', ''), ('time', 'ms'), ('rate_hz', '')]
    """
    if BRACKETED.fullmatch(heading):
        return split_bracketed(heading)
    spaced = re.fullmatch(r"(.*[^\s/,;:\-])(?<!\sin)\s+(\S+)", heading)
    if spaced and "/" in spaced[2] and units.told(spaced[2]) == "rpm":
        return spaced[1], "rpm"
    for pattern in TAILS:
        found = pattern.fullmatch(heading)
        # A dash or a single letter in a formula is not a unit here.
        if (
            found
            and found[2] != "-"
            and units.is_unit(found[2])
            and not units.TIME_FORMAT.fullmatch(found[2])
        ):
            return found[1], units.told(found[2])
    found = UNDERSCORED.fullmatch(heading)
    if found and is_time(found[1]) and found[2].lower() in SECONDS:
        return found[1], found[2]
    return heading, ""


def split_bracketed(heading: str) -> tuple[str, str]:
    """Split a heading only at a bracket, for names in which a slash has another meaning."""
    found = BRACKETED.fullmatch(heading)
    if found is None:
        return heading, ""
    return found[1], units.told(next((part for part in found.groups()[1:] if part), ""))


def plain(name: str) -> str:
    """Name in lower case without spaces, punctuation and trailing number."""
    text = unicodedata.normalize("NFC", name).lower()
    text = re.sub(r"[\s_\-./#%*'\"&+:;,!?()]+", "", text)
    return re.sub(r"(?<=[^\W\d])\d{1,2}$", "", text)


def is_time(name: str) -> bool:
    """Whether a column's name means time, or date and time.

    Examples
    --------
    >>> is_time("Zeit  1 - Standardmessrate"), is_time("X 1 - Position")
    (True, False)
    """
    counted = re.fullmatch(r"(\w{4,})\s+\d+\s+-\s+.+", name)
    return plain(counted[1] if counted else name) in WORDS


def is_date(name: str) -> bool:
    """Whether a column's name means a date."""
    return plain(name) in DATES


START_NAMES = frozenset(
    ["start", "xstart", "x_start", "t0", "x0", "xorigin", "x_origin", "xorg", "xzero", "x_zero", "hoffset"]
)
"""Names for the time of the first sample [s], in lower case with underscores."""


def stated_start(facts: Iterable[tuple[str, float]]) -> float:
    """Time of the first sample [s] among named values, else 0."""
    return next((value for name, value in facts if _key(name) in START_NAMES and np.isfinite(value)), 0.0)


def _key(name: str) -> str:
    return re.sub(r"[\s-]+", "_", name.strip().lower())


def stated_rate(facts: Iterable[tuple[str, object]]) -> float | None:
    """Sample rate [Hz] among named values, or None."""
    for name, value in facts:
        key = _key(name)
        number = np.asarray(value)
        if number.size != 1 or number.dtype.kind not in "iuf":
            continue
        known = float(number.reshape(-1)[0])
        if not 0.0 < known < np.inf:
            continue
        if key in RATE_NAMES or key.removesuffix("_hz") in RATE_NAMES:
            return known
        if key in INTERVAL_NAMES:
            return float(f"{1.0 / known:.12g}")
    return None
