"""Equations of a structure: what every one must compute, and defaults for what only some can."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.support.arrays import Array, ComplexArray, Names, Values


class Against(NamedTuple):
    """What outputs are compared with, and the filter of each residual."""

    measured: Array
    """Normalised outputs (O, N), NaN where masked."""
    offsets: Array
    """Added to the simulated outputs, shape (O,)."""
    filters: Array
    """FIR filter of each output's residual (O, T), the sample's own tap first."""
    sharp: bool = True
    """Whether the outputs must be exact; otherwise an error far below the noise may buy time."""


Sums = tuple[Array, int]
"""Sums of products of residuals and sensitivities of each output, filtered, and the number of samples."""


class Equations(ABC):
    """What a structure computes: outputs and their derivatives; the rest has defaults."""

    @property
    def states(self) -> tuple[str, ...]:
        """Initial states that may be estimated with an experiment, zero if not given; names start with "initial"."""
        return ()

    @property
    def linear_in(self) -> tuple[str, ...]:
        """Initial states in which the outputs are linear."""
        return ()

    @property
    def has_products(self) -> bool:
        """Whether `products` can be called."""
        return False

    @property
    def own_offsets(self) -> bool:
        """Whether the states hold the errors of the operating point, so that outputs need no constants added."""
        return False

    @property
    def has_valley(self) -> bool:
        """Whether `curved` knows along which curve the outputs change least."""
        return False

    @abstractmethod
    def simulate(self, values: Values, experiment: Experiment) -> Array:
        """Return the normalised outputs, shape (O, N)."""

    @abstractmethod
    def sensitivities(self, values: Values, experiment: Experiment, names: Names) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives with respect to `names`, shape (W, O, N)."""

    def response(
        self, values: Values, frequency_hz: Array, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response (O, F) and its derivatives with respect to `names`, shape (W, O, F).

        Raises
        ------
        InputError
            Where the equations have no frequency response.
        """
        raise InputError("this structure has no frequency response; fit it to an Experiment")

    def products(self, values: Values, experiment: Experiment, names: Names, against: Against) -> Sums:
        """Return sums of products of residuals and sensitivities of each output, filtered, and the number of samples.

        The columns of the sums (O, W + 2, O, W + 2) are the derivatives with respect to `names`, what an offset of the
        output adds, and its residual.
        """
        raise NotImplementedError

    def rough(self) -> Equations:
        """Return equations whose outputs have an error far below any noise, in less time if they can."""
        return self

    def stable(self, values: Values) -> bool:
        """Whether the closed loop is stable; True where the equations can't tell."""
        return True

    def curved(self, names: Names, vector: Array, step: Array, held: int | None = None) -> Array:
        """Return where a step from values of these names leads along the curve on which the outputs change least.

        To first order that is their sum, which it is where the equations know no better. The entry `held` takes its
        step as it is.
        """
        return vector + step
