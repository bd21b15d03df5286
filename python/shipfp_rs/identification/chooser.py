"""Fits of ship structures to one set of experiments, warm-started from each other."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from shipfp_rs.errors import IdentificationError, SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.experiments.interpolation import band_limited
from shipfp_rs.experiments.set_point_noise import without_noise
from shipfp_rs.identification.blocks import Block
from shipfp_rs.identification.clearing import Clearing
from shipfp_rs.identification.first_ends import at_limit, distinct, ends_of, with_lag
from shipfp_rs.identification.fitted import TRIAL_FALL, Fitted, cost
from shipfp_rs.identification.promise import PROPELLER_PART, Promise, promise
from shipfp_rs.identification.search import Search
from shipfp_rs.identification.start_vector import starts_from
from shipfp_rs.identification.starts import both_ended, starts
from shipfp_rs.identification.weighted_problem import Minimum, is_exact
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.structures.outputs import Torque
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.threads import where_alone

LOGGER = logging.getLogger("shipfp_rs")

CANDIDATES = (
    "dead_time_loop",
    "dead_time_set_point",
    "actuator_lag",
    "torque_limit",
    "twist",
    "late_torque",
    "sampling",
)
"""Elements that are tried, in the order of a report."""
FIRST = ("dead_time_loop", "dead_time_set_point")
"""Elements that the first fit has: where they do not act they go again, and without them a fit may lose its way."""
LAGS = "actuator_lag"
"""Element that the first fit may have in place of the first of these."""
CUTS = "torque_limit"
"""Element that changes what holding does."""
SAME = 0.5
"""Difference of the deviance that is not worth another choice."""
TOLD = 10.0
"""Fall of the deviance from which on the outputs tell which set point they follow."""
NEARLY = 100.0
"""Difference of the deviance, with white noise, within which the end of another start may be as good with coloured noise."""
LAGGING = 0.1
"""Fall of the deviance a sample, with white noise, from which on the first fit has a lag: the residuals' power falls by a
twentieth in each output. What a governor that samples holds is a hundredth, and is not taken off the records yet."""
CUT_OFF = 100.0
"""Fall of the deviance, with white noise, from which on the first fit has a torque limit."""
AFLOAT_ROUNDS = 2
"""Fits of a ship that knows the water: by the first fit's estimates, and once more."""
TRIAL_EVALUATIONS = 40
"""Passes over the records at most of a trial: enough to see what an element is worth."""
PART_BEHIND = 0.9
"""Part of the time constant behind the gauge, as the first regression has it, that the whole one can't be below."""
LIGHTEST_PROPELLER = 0.05
"""Least part of the inertia that is the propeller's; a shaft before less would swing faster than any record shows."""
MOST_EVALUATIONS = 200
"""Passes over the records of one search."""


class Chooser:
    """Fits structures of one set of experiments, warm-started from each other."""

    def __init__(
        self,
        experiments: Sequence[Experiment],
        *,
        torque: Torque,
        outputs: Sequence[str],
        forced: Sequence[str] = (),
        excluded: Sequence[str] = (),
        narrow: Mapping[str, Mapping[str, object]] | None = None,
        search: Mapping[str, object] | None = None,
        clock: tuple[float, float] | None = None,
    ) -> None:
        self.clock = clock
        """Period at which the governor samples and its deviation [s], where the raw torque told them."""
        self.experiments, self.torque, self.outputs = list(experiments), torque, tuple(outputs)
        self._logged = list(experiments)
        self._told = [one.dn_set for one in experiments]
        """Deviations of the set point as it was sampled, without noise where that is left out."""
        self.forced = tuple(forced)
        self.candidates = tuple(name for name in CANDIDATES if name not in excluded and name not in forced)
        self.narrow = narrow or {}
        self.band_limited = all(one.is_low_passed and one.hold == "first" for one in experiments)
        """Whether the set point between its samples is taken for a band-limited signal: one that was low-passed is."""
        if self.band_limited:
            self.experiments = [band_limited(one) for one in experiments]
        self.is_quiet = False
        """Whether the set point is taken without the noise that it was logged with: where the outputs do not follow that."""
        self.clears_limits = False
        """Whether records are cleared of what a torque limit makes of moving water: from a structure that nearly stands on,
        since with the load of one that does not water takes the misfit up."""
        self.elsewhere: list[dict[str, float]] = []
        """Ends of other starts that fit nearly as well as the best one."""
        self.begins: list[dict[str, float]] = []
        """The data's own starts."""
        self.options = {
            "weighting": "determinant",
            "noise": "ar",
            "max_evaluations": MOST_EVALUATIONS,
            "tolerance": 1e-10,
        }
        self.options |= dict(search or {})

    def structure(self, elements: Sequence[str]) -> Structure:
        """Return the ship with these elements, narrowed as the user asks."""
        made = Structure.ship(
            elements,
            torque=self.torque,
            outputs=self.outputs,
            products="dX" not in self.outputs,
            mean_sampling=self.clock is not None,
        )
        for verb, given in self.narrow.items():
            known = {name: value for name, value in given.items() if name in made.names}
            made = getattr(made, f"with_{verb}")(**known)
        return made

    def search(self, elements: Sequence[str], experiments: Sequence[Experiment] | None = None) -> Search:
        """Return the search of a structure over all experiments."""
        structure = self.structure(elements)
        blocks = tuple(
            Block.build(one, structure, offsets=False, initial_state=True, weigh=False)
            for one in experiments or self.experiments
        )
        return Search(structure, blocks, **self.options)  # type: ignore[arg-type]

    def first(self) -> Fitted:
        """Fit the first structure from the data's own starts."""
        elements = self.ordered({*self.forced, *(name for name in FIRST if name in self.candidates)})
        search = self.search(elements)
        begins = self.begins = starts(search.structure, self.experiments)
        if "tau_prop" in begins[0] and "tau_n" not in {
            **self.narrow.get("fixed", {}),
            **self.narrow.get("prior", {}),
        }:
            # The inertia behind the gauge is part of the whole.
            least = PART_BEHIND * min(values["tau_prop"] for values in begins)
            upper = search.structure["tau_n"].upper
            self.narrow = {**self.narrow, "bounds": {"tau_n": (least, max(2.0 * least, 1.2), upper)}}
            search = self.search(elements)
        ends = ends_of(search, begins)
        if not ends:
            raise IdentificationError(
                "no start that the data suggest can be simulated; check the channels' signs, units and operating point"
            )
        if {LAGS, FIRST[0]} <= {*self.candidates}:
            # A dead time does not do what a long lag does, and a fit that has it may lose its way.
            own = self.ordered({*elements, LAGS} - {FIRST[0]})
            lagging = self.search(own)
            others = ends_of(lagging, with_lag(begins))
            enough = LAGGING * sum(block.count for block in search.blocks)
            if others and others[0].criterion < ends[0].criterion - enough:
                elements, search, ends, begins = own, lagging, others, with_lag(begins)
        if CUTS in self.candidates:
            # A limit that cuts much off leads a fit without it so far astray that it is not found from there any more.
            limited = self.search(self.ordered({*elements, CUTS}))
            others = ends_of(limited, at_limit(limited, self.experiments, begins))
            if others and others[0].criterion < ends[0].criterion - CUT_OFF:
                elements, search, ends = self.ordered({*elements, CUTS}), limited, others
        best = ends[0]
        self.elsewhere = [
            dict(zip(search.unknowns, map(float, end.vector), strict=True))
            for end in distinct(search, ends)[1:]
            if end.criterion - best.criterion < NEARLY
        ]
        if "tau_prop" not in search.names:
            whole = search.values(best.vector)["tau_n"]
            limits = {"tau_prop": (LIGHTEST_PROPELLER * whole, PROPELLER_PART * whole, whole)}
            self.narrow = {**self.narrow, "bounds": {**self.narrow.get("bounds", {}), **limits}}
        if self._clears(elements):
            try:
                cleared = self._cleared(search, best.vector)
                search, best = cleared, cleared.minimise(best.vector)
            except (IdentificationError, SimulationError) as error:
                LOGGER.debug("identify: records could not be cleared by the first fit: %s", error)
        if not self.band_limited:
            changed = [band_limited(one) if one.hold == "first" else one for one in self.experiments]
            self.band_limited = True
            search, best, self.band_limited = self._fed(changed, self._told, search, best)
        if is_exact(search, best):
            # Nothing but rounding is left, which no noise model describes.
            self.options["noise"] = "white"
            search = replace(search, noise="white")
        fitted = Fitted(elements, search, best)
        quiet = self.quietened(fitted)
        return self.refined(fitted) if quiet is None else quiet

    def quietened(self, fitted: Fitted) -> Fitted | None:
        """Return the fit to set points without noise, if the outputs follow those better; None where they do not.

        A structure that misses much does not tell: then it is to be asked again with a better one.
        """
        if self.is_quiet:
            return None
        changed = [without_noise(one) for one in self.experiments]
        told = [without_noise(one).dn_set for one in self._logged]
        search, best, self.is_quiet = self._fed(changed, told, fitted.search, fitted.minimum)
        return self.refined(Fitted(fitted.elements, search, best)) if self.is_quiet else None

    def _fed(
        self, changed: list[Experiment], told: list[Array], search: Search, best: Minimum
    ) -> tuple[Search, Minimum, bool]:
        """Take experiments with a changed set point in place of theirs if the outputs follow it better; tell whether.

        `told` are the changed set points as they were sampled.
        """
        before = self.experiments, self._told
        self.experiments, self._told = changed, told
        elements = self.ordered(search.structure.settings["elements"])
        try:
            # Beside moving water what a set point's noise does is nothing, but where there is no water.
            here = Fitted(elements, search, search.refine(best, last=False)).base
            other = replace(
                self._cleared(self.search(elements), best.vector),
                weights=here.minimum.noise,
                enough=TRIAL_FALL,
                max_evaluations=TRIAL_EVALUATIONS,
            )
            trial = other.minimise(here.minimum.vector)
        except (IdentificationError, SimulationError) as error:
            LOGGER.debug("identify: a changed set point could not be simulated: %s", error)
        else:
            if trial.criterion < here.minimum.criterion - TOLD:
                search = replace(other, weights=None, enough=search.enough, max_evaluations=MOST_EVALUATIONS)
                return search, replace(trial, noise=here.minimum.noise), True
        self.experiments, self._told = before
        return search, best, False

    def _clears(self, elements: Sequence[str]) -> bool:
        """Whether records are cleared of what the model leaves out: images, what holding does, and what limits do."""
        return self.clock is not None or self.band_limited or (self.clears_limits and CUTS in elements)

    def _held(self, fitted: Fitted) -> Fitted:
        """Return a fit to records cleared by a fit's end; where nothing is to be cleared that fit itself."""
        if not self._clears(fitted.elements):
            return fitted
        try:
            minimum = self._afloat(fitted)
            search = self._cleared(fitted.search, minimum.vector)
            return Fitted(fitted.elements, search, search.refine(minimum))
        except (IdentificationError, SimulationError) as error:
            LOGGER.debug("identify: records could not be cleared by a fit: %s", error)
            return fitted

    def _afloat(self, fitted: Fitted) -> Minimum:
        """Return where the fit of a ship that knows the water ends; of one without a limit, where it is.

        What a limit makes of the water depends so much on the estimates that to clear the records again and again leads
        nowhere.
        """
        minimum = fitted.minimum
        if not self.clears_limits or CUTS not in fitted.elements or "load" in fitted.elements:
            return minimum
        for _ in range(AFLOAT_ROUNDS):
            try:
                minimum = self._knowing_water(fitted, minimum)
            except (IdentificationError, SimulationError) as error:
                LOGGER.debug("identify: a ship that knows the water could not be fitted: %s", error)
                break
        return minimum

    def _knowing_water(self, fitted: Fitted, minimum: Minimum) -> Minimum:
        """Fit a ship that knows the water which a minimum leaves, from there on."""
        blocks = []
        for raw, told, (_, values) in zip(
            self.experiments, self._told, fitted.search.each(minimum.vector), strict=True
        ):
            structure, experiment = self._clearing.afloat(fitted.search.structure, values, raw, told)
            blocks.append(Block.build(experiment, structure, offsets=False, initial_state=True, weigh=False))
        search = replace(
            fitted.search,
            structure=structure,
            blocks=tuple(blocks),
            max_evaluations=TRIAL_EVALUATIONS,
            enough=TRIAL_FALL,
        )
        return search.refine(minimum)

    @property
    def _clearing(self) -> Clearing:
        return Clearing(self.clock is not None, self.clears_limits, self.band_limited)

    def _cleared(self, search: Search, vector: Array) -> Search:
        """Return the search of records less what the model leaves out at a vector."""
        elements = self.ordered(search.structure.settings["elements"])
        if not self._clears(elements):
            return search
        experiments = [
            self._clearing.of(search.structure, values, raw, told)
            for raw, told, (_, values) in zip(self.experiments, self._told, search.each(vector), strict=True)
        ]
        return replace(search, blocks=self.search(elements, experiments).blocks)

    def with_elements(
        self,
        origin: Fitted,
        elements: Sequence[str],
        begin: Mapping[str, float] | None = None,
        worth: float = np.inf,
    ) -> Fitted | None:
        """Fit other elements with the weights of a fit, from its end; None where that can't be simulated.

        `begin` holds the start of a new element's parameter; otherwise all of `STARTS` are tried. A fit that can't get
        its cost below `worth` is given up.
        """
        ordered = self.ordered(elements)
        search = replace(
            self.search(ordered, origin.records),
            weights=origin.minimum.noise,
            enough=TRIAL_FALL,
            worth=worth,
            max_evaluations=TRIAL_EVALUATIONS,
        )
        values = dict(zip(origin.search.unknowns, map(float, origin.minimum.vector), strict=True)) | dict(
            begin or {}
        )
        if "tau_n" in values:
            # Of the inertia that a shaft's twist divides, the propeller's is a part.
            values.setdefault("tau_prop", PROPELLER_PART * values["tau_n"])
        if "twist" in ordered and "tau_prop" in origin.search.names:
            search = replace(search, structure=both_ended(search.structure, values["tau_prop"]))
        # What a limit cuts off is told by a fit that has it; one without it is given the records back.
        changed = CUTS in set(ordered) ^ set(origin.elements)
        again = self.band_limited and self.clock is None
        clears = again or (
            changed and (self.clock is not None or (self.clears_limits and CUTS in origin.elements))
        )
        jobs = [
            partial(self._trial, ordered, search, start, clears=clears)
            for start in starts_from(search, values)
        ]
        ends = where_alone(jobs)
        best = min((end for end in ends if end is not None), key=cost, default=None)
        if best is None or not again:
            return best
        # A new lag or dead time changes what is taken off the record.
        return self._trial(ordered, best.search, best.minimum.vector, clears=True) or best

    def _trial(
        self, elements: tuple[str, ...], search: Search, start: Array, *, clears: bool
    ) -> Fitted | None:
        """Fit from a start, to records cleared there if so asked; None where that can't be simulated."""
        try:
            own = self._cleared(search, start) if clears else search
            return Fitted(elements, own, own.minimise(start))
        except (IdentificationError, SimulationError) as error:
            LOGGER.debug("identify: %s could not be fitted: %s", ", ".join(elements), error)
            return None

    def promise(self, origin: Fitted, name: str) -> Promise:
        """Return what an element promises beside a fit."""
        return promise(name, origin.search, origin.minimum, self.structure((*origin.elements, name)))

    def refined(self, fitted: Fitted, *, last: bool = False) -> Fitted:
        """Fit weights and noise models of its own to a structure; to the end where it is the last fit of that structure."""
        search = replace(
            fitted.search,
            weights=None,
            enough=TRIAL_FALL,
            worth=np.inf,
            max_evaluations=MOST_EVALUATIONS,
        )
        fitted = Fitted(fitted.elements, search, search.refine(fitted.minimum))
        fitted = self._held(fitted)
        if not last:
            return fitted
        # On the way each output's own colour does, in a fraction of the time.
        noise = "spectrum" if self.options["noise"] == "ar" else self.options["noise"]
        search = replace(fitted.search, enough=None, noise=str(noise))
        return Fitted(fitted.elements, search, search.refine(fitted.minimum))

    def ordered(self, elements: Sequence[str] | set[str]) -> tuple[str, ...]:
        """Return elements in the table's order."""
        return tuple(name for name in ELEMENTS if name in elements)
