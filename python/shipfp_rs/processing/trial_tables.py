"""Tables of a TRIAL.toml other than channels: header, operating point, processing, windows, identification."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from shipfp_rs.processing.trial_channels import Pair, Positive, Rate
from shipfp_rs.support.hints import nearest
from shipfp_rs.support.languages import LANGUAGES
from shipfp_rs.support.toml import FilePath, Name, Section, Seed, Starts, unexpected

Relation = Annotated[
    tuple[str, float, float],
    Field(strict=False),
    BeforeValidator(lambda value: [*value, 0.0] if isinstance(value, list) and len(value) == 2 else value),
]
"""Name of a parameter, factor and offset; the default offset is 0."""
Share = Annotated[float, Field(ge=1e-9, le=1e3)]
Sigmas = Annotated[float, Field(ge=0.1, le=1e6)]
Stretch = Annotated[float, Field(ge=1e-6, le=3600.0)]
"""Length of a fault [s]."""
Auto = Annotated[Positive | None, BeforeValidator(lambda value: None if value == "auto" else value)]
"""A positive number, or "auto" (None)."""

KINDS = ("steady", "sine", "sines", "chirp", "steps", "multisine", "squares", "prbs", "noise", "other")
"""Usual kinds of windows."""


class Header(Section):
    """The trial: name, ship and recordings."""

    name: Name
    """Name of the trial in the report."""
    vessel: FilePath = "direct-drive"
    """Name of a built-in ship or path of a vessel file; by default there is no gear between engine and shaft."""
    log: Annotated[
        tuple[FilePath, ...],
        Field(strict=False, min_length=1, max_length=1000),
        BeforeValidator(lambda value: [value] if isinstance(value, str) else value),
    ]
    """One path or several, relative to the folder of TRIAL.toml."""
    rate_hz: Rate | None = None
    """Sample rate of logs that state none [Hz]."""
    time_column: str | None = None
    """Time column of a table, if it is not detected: "COLUMN", "COLUMN [ms]", "DATE [d.m.y] + CLOCK"."""
    names: FilePath | None = None
    """File with the names of the channels: a DBC for a CAN log, a channel list for ISO 19848."""


class Align(Section):
    """Alignment of several loggers with separate clocks to the clock of one of them."""

    reference: FilePath
    """File name of the log with the reference clock; all windows are on it."""
    common: Name | None = None
    """Channel in every log, such as the set point's voltage or a pulse train; without one, the logs share a clock and
    their time stamps count.
    """
    pulses: bool = False
    """Whether the common channel is a pulse train."""


class OperatingPoint(Section):
    """The steady state for the normalisation of signals: given, or "auto" from a steady stretch."""

    n_e_rpm: Auto = None
    """Engine speed [rpm]."""
    M_Nm: Auto = None
    """Torque at the location of the torque channel [Nm]; also that of the load, if the load has no steady stretch."""
    X_mm: Auto = None
    """Value of the rack's channel, in the unit of its calibration."""
    steady_s: Pair | None = None
    """Start and stop of a stretch with a constant set point, on the log's clock [s]."""

    @model_validator(mode="after")
    def _can_be_had(self) -> Self:
        if self.steady_s is not None and not self.steady_s[0] < self.steady_s[1]:
            raise unexpected("steady_s", list(self.steady_s), "[start, stop] with start before stop")
        return self


class Spikes(Section):
    """Short excursions from the running median that count as faults."""

    longest_s: Stretch = 0.05
    """Longest spike [s]; motions of the plant last longer. In a channel that holds values longer, a spike is one value."""
    threshold: Sigmas = 6.0
    """Height in robust standard deviations about the running median."""
    least: Share = 0.05
    """Least height of a fault, relative to the median magnitude."""


class Faults(Section):
    """Limits of the faults of a recorded channel, apart from spikes."""

    stuck_s: Stretch = 0.25
    """Shortest stretch of equal samples in an otherwise noisy channel [s]."""
    dropout_s: Stretch = 0.01
    """Shortest stretch at zero of a channel that stays away from it [s]."""
    clipped_samples: Annotated[int, Field(ge=2, le=1_000_000_000)] = 8
    """Least number of samples at the extreme value of a clipped channel."""
    longest_bridge_s: Stretch = 0.25
    """Longest stretch of a lost set point that is bridged by a straight line [s]; the outputs are masked there."""
    mains_hz: Annotated[float, Field(ge=1.0, le=1000.0)] = 50.0
    """Frequency of the mains, whose hum is removed from the set point [Hz]."""
    least_hum: Share = 1e-3
    """Least amplitude of hum, relative to the set point."""


class Processing(Section):
    """Processing of raw channels to signals."""

    rate_hz: Rate = 50.0
    """Common rate of the signals [Hz]. Above the tachometer's bandwidth the speed is only interpolated, and a fit with
    whitened residuals would take that for signal; four reflectors on a shaft at 5 rev/s give 10 Hz.
    """
    normalise: Literal["global", "local"] = "global"
    """Normalise with the trial's operating point, or each window with its own means."""
    detrend: Annotated[int, Field(ge=0, le=3)] = 0
    """Degree of a polynomial drift that is removed from the outputs; 0: none. Outputs of a window whose set point is such a
    trend itself, a stair of steps, are not changed.
    """
    speed: Literal["best", "fused"] = "best"
    """"best": the speed of the train with the most good intervals. "fused": from the pulses of all trains, each weighted by
    its timing and reflectors; this takes about ten seconds more per hour of log and gives the speed's standard deviation.
    """
    torque_spikes: Spikes = Spikes()
    """Limits for spikes of the torque, of the rack, of the load, and of a recorded speed."""
    set_point_jumps: Spikes = Spikes()
    faults: Faults = Faults()


def _no_slip(word: str) -> str:
    """Reject a misspelt kind; any other word is the user's own."""
    if word not in KINDS and (near := nearest(word, KINDS, 0.75)):
        raise PydanticCustomError(
            "kind", "one of {known}, or a word of your own{near}", {"known": ", ".join(KINDS), "near": near}
        )
    return word


class Window(Section):
    """One stretch of a log, one experiment."""

    name: Name
    """Name of the experiment; each name once."""
    kind: Annotated[str, Field(max_length=40), AfterValidator(_no_slip)] = ""
    """Kind of motion of the set point: any word; the report repeats it."""
    start_s: float
    """Start on the log's clock [s]."""
    stop_s: float
    """End on the log's clock [s]."""
    log: FilePath | None = None
    """File name of the window's log; default: the first one."""

    @model_validator(mode="after")
    def _is_not_empty(self) -> Self:
        if not self.start_s < self.stop_s:
            raise unexpected("stop_s", f"{self.stop_s:g}", f"more than start_s, {self.start_s:g}")
        return self


HOW = ("noise", "starts")
"""Keys of [identify] that are options of `identify` with the same name."""
NARROWING = frozenset(("elements", "torque", "outputs", "fixed", "priors", "seed"))
"""Keys of [identify] that limit the data's selection of a structure; any other key declares the structure."""
OF_THE_FULL_SHIP: Mapping[str, tuple[Any, ...]] = {
    "products": (True,),
    "tied": ({},),
    "noise": (None, "coloured"),
    "starts": (None, 1),
}
"""Defaults of the other keys: with these the full ship is fitted, and no structure is declared."""


def _a_language(word: str) -> str:
    if word not in LANGUAGES:
        raise PydanticCustomError("language", "one of {known}", {"known": ", ".join(LANGUAGES)})
    return word


class Report(Section):
    """Settings of report.html."""

    language: Annotated[str, AfterValidator(_a_language)] = "en"
    """Language of the report: "en", or one into which the package is translated, such as "de"."""


class Identify(Section):
    """The structure to fit, and how; names of elements and parameters are checked by the structure itself.

    Without a key other than `NARROWING` the data select the elements of the ship; with such a key, only elements given as
    true act. A default that is written out changes nothing.
    """

    elements: dict[str, bool] = Field(default_factory=dict)
    """Elements that act (true) or do not (false); where the data select, they decide about the others."""
    torque: Literal["gauge", "brake"] | None = None
    """Side of the torque; default: the location of the torque channel."""
    products: bool = True
    """Fit vK_p and vK_i instead of v, K_p and K_i, which speed and torque can't determine separately."""
    outputs: Annotated[tuple[str, ...], Field(strict=False, min_length=1)] = ("dn", "dM")
    """Outputs that are compared: speed dn, torque dM, rack dX; where the data select, all that were measured."""
    fixed: dict[str, float] = Field(default_factory=dict)
    """Known value of each fixed parameter."""
    priors: dict[str, Pair] = Field(default_factory=dict)
    """Mean and standard deviation of each parameter known beforehand."""
    tied: dict[str, Relation] = Field(default_factory=dict)
    """Relation of each tied parameter: [name of another one, factor] or [name, factor, offset]."""
    noise: Literal["coloured", "white"] | None = None
    """Assumed noise of the residuals, as in `identify`."""
    starts: Starts | None = None
    """Number of starts of the search, as in `identify`."""
    seed: Seed = 0
    """Seed of the random starts."""

    @property
    def options(self) -> dict[str, Any]:
        """Options of `identify`, except the seed."""
        return {name: getattr(self, name) for name in HOW}

    @property
    def chooses(self) -> bool:
        """Whether the data select the structure."""
        return all(getattr(self, name) in values for name, values in OF_THE_FULL_SHIP.items())

    @property
    def acting(self) -> tuple[str, ...]:
        """Elements of the declared structure."""
        return tuple(name for name, acts in self.elements.items() if acts)
