"""Frequency responses: complex ratios of normalised outputs to the normalised set point."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.support.arguments import check_fields, checked, told
from shipfp_rs.support.arrays import Array, ComplexArray
from shipfp_rs.support.tables import Columns, Tabular, shown

FREQUENCY = "frequency_hz"
_PARTS = ("amplitude_std", "phase_std", "coherence")
MOST_TURNS = 4.0
"""Number of turns above which a fitted phase is assumed to be in degrees."""


@dataclass(frozen=True, eq=False)
class FrequencyResponse(Tabular):
    """Measured responses of the outputs to the set point, eq. 7.1 and 7.2.

    Parameters
    ----------
    name
        Label in tables and plots.
    frequency_hz
        Frequencies [Hz], shape (F,), positive.
    response
        Signal name ("n_e", "M_g", ...) to the complex ratio of its normalised deviation to that of the set
        point, shape (F,); NaN where a point is missing.
    amplitude_std, phase_std
        Signal name to the relative standard deviation of the amplitude [-] and to that of the phase [rad], shape (F,), where
        known. They differ: a frequency error of a sine fit affects the phase but not the amplitude.
    operating_point
        Signal name to the value by which it was normalised.
    provenance
        Source and processing of the numbers.
    coherence
        Signal name to the share of its power that the set point explains [-], shape (F,), where known.
    """

    name: str
    frequency_hz: Array
    response: Mapping[str, ComplexArray]
    amplitude_std: Mapping[str, Array] = field(default_factory=dict)
    phase_std: Mapping[str, Array] = field(default_factory=dict)
    operating_point: Mapping[str, float] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    coherence: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_fields(self, f"response {told(self.name)}")
        frequency = _frozen(self.frequency_hz, np.float64)
        if frequency.ndim != 1 or frequency.size == 0:
            raise InputError(
                f"response {self.name!r}: frequency_hz has shape {frequency.shape}, expected (F,), F > 0"
            )
        if not (np.isfinite(frequency).all() and (frequency > 0).all()):
            raise InputError(
                f"response {self.name!r}: frequency_hz must be finite and positive, found {frequency.min()}"
            )
        object.__setattr__(self, "frequency_hz", frequency)
        for attribute, dtype in (
            ("response", np.complex128),
            ("amplitude_std", np.float64),
            ("phase_std", np.float64),
            ("coherence", np.float64),
        ):
            group = {key: _frozen(value, dtype) for key, value in getattr(self, attribute).items()}
            for key, values in group.items():
                if values.shape != frequency.shape:
                    raise InputError(
                        f"response {self.name!r}: {attribute} of {key!r} has shape {values.shape}, expected "
                        f"{frequency.shape} as frequency_hz"
                    )
            object.__setattr__(self, attribute, MappingProxyType(group))
        if set(self.amplitude_std) != set(self.phase_std):
            raise InputError(
                f"response {self.name!r}: amplitude_std of {sorted(self.amplitude_std)} but phase_std of "
                f"{sorted(self.phase_std)}; give both of the same outputs"
            )
        for attribute in ("amplitude_std", "phase_std"):
            for key, values in getattr(self, attribute).items():
                if key not in self.response:
                    raise InputError(f"response {self.name!r}: {attribute} of {key!r}, which has no response")
                if not (values > 0).all():
                    raise InputError(
                        f"response {self.name!r}: {attribute} of {key!r} must be positive, found {np.min(values)}"
                    )
        for attribute, most, slip in (
            ("amplitude_std", 1.0, "percent for a fraction"),
            (
                "phase_std",
                math.pi / math.sqrt(3.0),
                "degrees for radians",
            ),  # the standard deviation of a completely unknown phase
        ):
            for key, values in getattr(self, attribute).items():
                if len(values) > 1 and values.min() > most:
                    raise InputError(
                        f"response {self.name!r}: {attribute} of {key!r} is {values.min():.3g} at best, expected less "
                        f"than {most:.3g} at some frequency; {slip}?"
                    )
        if not self.response:
            raise InputError(f"response {self.name!r}: no output")

    def __len__(self) -> int:
        return len(self.frequency_hz)

    def __repr__(self) -> str:
        low, high = self.frequency_hz.min(), self.frequency_hz.max()
        signals = ", ".join(self.response)
        return (
            f"FrequencyResponse({self.name!r}, {len(self)} points from {low:.4g} to {high:.4g} Hz: {signals})"
        )

    def _repr_html_(self) -> str:
        head = ["frequency [Hz]"]
        for name in self.response:
            head += [f"|{name}| [-]", f"arg {name} [deg]"]
        rows = []
        for index, frequency in enumerate(self.frequency_hz):
            cells = [f"{frequency:.4g}"]
            for values in self.response.values():
                cells += [f"{abs(values[index]):.4g}", f"{math.degrees(np.angle(values[index])):.1f}"]
            rows.append(cells)
        return shown(f"Frequency response {self.name}", head, rows)

    def _columns(self) -> Columns:
        values, units = {FREQUENCY: self.frequency_hz}, {FREQUENCY: "Hz"}
        for name, response in self.response.items():
            values |= {f"{name}.real": response.real, f"{name}.imag": response.imag}
            values |= {f"{name}.{part}": group[name] for part, group in self._parts() if name in group}
            units |= {
                f"{name}.{part}": "rad" if part == "phase_std" else "1" for part in ("real", "imag", *_PARTS)
            }
        facts = {
            "name": self.name,
            "operating_point": dict(self.operating_point),
            "provenance": dict(self.provenance),
        }
        return Columns(values, units, facts)

    def _parts(self) -> tuple[tuple[str, Mapping[str, Array]], ...]:
        return tuple((part, getattr(self, part)) for part in _PARTS)

    @classmethod
    def _from_columns(cls, values: Mapping[str, Array], facts: Mapping[str, Any]) -> Self:
        index, *columns = values
        names = list(dict.fromkeys(column.rpartition(".")[0] for column in columns))
        groups: dict[str, dict[str, Any]] = {part: {} for part in ("response", *_PARTS)}
        for name in names:
            missing = [f"{name}.{part}" for part in ("real", "imag") if f"{name}.{part}" not in values]
            if not name or missing:
                raise InputError(
                    f"columns {', '.join(columns)}: expected pairs such as n_e.real and n_e.imag; add them or leave "
                    "the others out"
                )
            groups["response"][name] = values[f"{name}.real"] + 1j * values[f"{name}.imag"]
            for part in _PARTS:
                if f"{name}.{part}" in values:
                    groups[part][name] = values[f"{name}.{part}"]
        given: dict[str, Any] = {"name": "response", **facts, **groups}
        return cls(frequency_hz=values[index], **given)

    @checked
    def select(self, keep: npt.ArrayLike, *, name: str | None = None) -> FrequencyResponse:
        """Return the points where a mask is true.

        Parameters
        ----------
        keep
            Boolean mask, shape (F,).
        name
            Label; None: unchanged.

        Raises
        ------
        InputError
            If the mask has another shape.
        """
        mask = np.asarray(keep, dtype=bool)
        if mask.shape != self.frequency_hz.shape:
            raise InputError(
                f"response {self.name!r}: mask has shape {mask.shape}, expected {self.frequency_hz.shape}"
            )
        return FrequencyResponse(
            name=name or self.name,
            frequency_hz=self.frequency_hz[mask],
            response={key: values[mask] for key, values in self.response.items()},
            amplitude_std={key: values[mask] for key, values in self.amplitude_std.items()},
            phase_std={key: values[mask] for key, values in self.phase_std.items()},
            operating_point=self.operating_point,
            provenance=self.provenance,
            coherence={key: values[mask] for key, values in self.coherence.items()},
        )


@checked
def sine_response(
    output: tuple[npt.ArrayLike, npt.ArrayLike, npt.ArrayLike],
    set_point: tuple[npt.ArrayLike, npt.ArrayLike, npt.ArrayLike],
) -> ComplexArray:
    """Return the complex response from fitted sines a + b sin(ct + d): (b/a of the output) over (b/a of the set point).

    Parameters
    ----------
    output, set_point
        (offset, amplitude, phase [rad]) of each sine, arrays of the same shape. Each channel is normalised by its offset,
        the local operating point. The phase of the response is d_out - d_in; appendix E of the thesis prints sin(ct - d), by
        which the response would lead.

    Returns
    -------
    ndarray
        Complex response, the shape of the inputs.

    Raises
    ------
    InputError
        If the phases are so large that they must be degrees.
    """
    a_out, b_out, d_out = (np.asarray(part, dtype=np.float64) for part in output)
    a_in, b_in, d_in = (np.asarray(part, dtype=np.float64) for part in set_point)
    for name, phase in (("output", d_out), ("set_point", d_in)):
        if phase.size and np.nanmax(np.abs(phase)) > MOST_TURNS * 2.0 * math.pi:
            raise InputError(
                f"sine_response: the phases of {name} reach {np.nanmax(np.abs(phase)):.4g}, expected radians; degrees for "
                "radians? convert them with numpy.radians"
            )
    return np.asarray((b_out / a_out) / (b_in / a_in) * np.exp(1j * (d_out - d_in)), dtype=np.complex128)


def _frozen(values: npt.ArrayLike, dtype: type) -> npt.NDArray[Any]:
    array: npt.NDArray[Any] = np.array(values, dtype=dtype)
    array.flags.writeable = False
    return array
