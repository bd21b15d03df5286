"""Interface of the model of one record: the compared data, the model's residual, and its derivatives."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Container, Mapping, Sequence
from typing import Any, Literal, NamedTuple, Self

import numpy as np

from shipfp_rs.support.arrays import Array, Numbers


class Units(NamedTuple):
    """Noise and systematic errors of a record as a kernel takes them: noise root, whitened errors, their hat functions."""

    root: Array
    shapes: Array
    hats: Array


class Model(ABC):
    """The model of one record. Its columns are the residual and the derivatives by its own parameters and unknowns."""

    record: Any
    """The data in the form that is compared."""
    unknowns: tuple[str, ...]
    """Unknowns of the record, such as its initial state or an offset."""
    noise: Literal["coloured", "white", "known"]
    """"coloured": a spectral matrix; "white": one covariance; "known": residuals are in standard deviations."""
    is_pooled = False
    """Whether all such records with white noise share one covariance."""
    limited = False
    """Whether the model has a limit of torque or rate."""
    has_walls = False
    """Whether the search has penalties near the longest sampling period and the largest inertia behind a gauge."""

    @property
    @abstractmethod
    def spectrum(self) -> Numbers:
        """Compared data, spectrum or samples, shape (O, F)."""

    @abstractmethod
    def rows(self, values: Mapping[str, float], own: Array, names: Sequence[str]) -> Numbers:
        """Residual and derivatives by own parameters and unknowns, (1 + M + U, O, F); without `names` the residual alone."""
        # `own` are the record's unknowns (U,). Raises `SimulationError` if the model diverges or its loop is unstable.

    def link(self, values: Mapping[str, float], names: Sequence[str]) -> Array:
        """Derivatives of the model's own parameters by the searched parameters `names`, (M, W)."""
        del values
        return np.eye(len(names))

    @property
    def has_effect(self) -> bool:
        """Whether residuals have a part without derivatives in closed form, which `effect` computes."""
        return False

    def effect(self, values: Mapping[str, float], own: Array) -> Numbers:
        """Effect on the outputs that `rows` leaves out, (O, F)."""
        raise NotImplementedError

    @property
    def frequency_hz(self) -> Array | None:
        """Compared frequencies [Hz], (F,); None for samples and responses, which have no systematic errors."""
        return None

    @property
    @abstractmethod
    def numbers(self) -> int:
        """Number of real values of each output, for white noise."""

    @property
    @abstractmethod
    def first_root(self) -> Numbers:
        """Root of the inverse covariance of the noise before any estimate, (O, O)."""

    @property
    def told(self) -> Array | float:
        """Measured share of each output's data, (O,); interpolated samples carry no information on the noise."""
        return 1.0

    def compared(self, spectra: Numbers) -> Numbers:
        """Part of residuals (..., O, F) that carries noise."""
        return spectra

    def prepared(self, values: Mapping[str, float]) -> Self:
        """Return the model prepared for the estimate of its noise at these parameters."""
        del values
        return self

    def bent(
        self, response: Numbers, values: Mapping[str, float], accuracy: Array, free: Container[str]
    ) -> Numbers:
        """Response (O, F) to which systematic errors are relative, computed from the model's response."""
        del values, accuracy, free
        return response

    def informed(
        self, left: Numbers, values: Mapping[str, float], own: Array, accuracy: Array, free: Container[str]
    ) -> Self:
        """Return the model with further `information` from the residuals (O, F) without systematic errors."""
        del left, values, own, accuracy, free
        return self

    def information(self, values: Mapping[str, float], own: Array, names: Sequence[str]) -> Array | None:
        """Further rows of the deviance by the model's own columns, (K, 1 + M + U), or None."""
        del values, own, names
        return None

    @property
    def expected(self) -> float:
        """Expected deviance of the `information`, which is subtracted so that more information is no disadvantage."""
        return 0.0

    @property
    def held(self) -> float:
        """Share of the time in which a clamp is active, so that the loop is open."""
        return 0.0

    def opened(self, values: Mapping[str, float]) -> float:
        """Deviance that is added because the loop is open while a clamp is active."""
        del values
        return 0.0

    def is_corrected(self, free: Container[str]) -> bool:
        """Whether the model corrects the record: its gaps, images of the set point, or the slip of a flexible shaft."""
        del free
        return False

    def corrected(self, values: Mapping[str, float], own: Array) -> Self:
        """Return the model with its record corrected by the model at these parameters."""
        del values, own
        return self
