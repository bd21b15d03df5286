"""A fit's deviance beside that at the truth: whether the search or the model is to blame where an answer is wrong.

    python -m tests.families.diagnosis --family all --draws 3 --seed 60000

For each ship three deviances over that of the fit, under the noise that the fit ended with: at the truth within the
fit's own elements, at the truth with all that acts, and where a descent from that truth ends. At the truth only the
records' states and nuisances go to their best. Chance gives about as many as there are parameters. Far more at the whole
truth: the model or its noise is wrong. Far more only within the fit's elements: one is missing. Less than none: the
search ended in a wrong basin. "own" is the end of the descent from the truth again, each end under the noise of its own
residuals.
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import replace

from tests.families.draw import FAMILIES, draw

NEEDED = {"torque_limit": "M_max", "rack_rate": "rate", "twist": "tau_twist"}
"""Elements that a fit tries, by the parameter that says how large they are."""
NUISANCES = ("hold", "M_soft")


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.families.diagnosis", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--family", choices=[*FAMILIES, "all"], default="tug")
    parser.add_argument("--draws", type=int, default=3)
    parser.add_argument("--seed", type=int, default=1000)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    for family in FAMILIES if options.family == "all" else (options.family,):
        for seed in range(options.seed, options.seed + options.draws):
            print(told(family, seed), flush=True)


def told(family, seed) -> str:
    """Fit a draw and return a line about its deviances."""
    import shipfp_rs as fp
    from shipfp_rs.identification.question import question_of
    from shipfp_rs.identification.ship_fit import fit_ship

    drawn = draw(family, seed, load=False)
    truth = drawn.truth()
    fit = fit_ship(question_of([fp.Experiment(**drawn.experiment())]))
    gains = ", ".join(f"{name} {gain:.0f}" for name, gain in fit.gains.items())
    found = " ".join(f"{name} {value:+.0f}" for name, value in deviances(fit, truth).items())
    return f"{family} {seed}: {found}; acts {' '.join(truth['on'])}; found {' '.join(fit.elements)} (gains {gains})"


def deviances(fit, truth) -> dict[str, float]:
    """Return the deviances at a truth over that of a fit."""
    whole = [name for name, parameter in NEEDED.items() if parameter in truth["on"]]
    rows = {}
    for label, elements in {"within": list(fit.elements), "whole": whole}.items():
        likelihood, vector = at_truth(fit, truth, elements)
        rows[label] = likelihood.cost(vector) - fit.best.cost
    likelihood, end = begun(fit, truth, whole)
    own = likelihood.total(end.vector) - fit.likelihood.total(fit.best.vector)
    return rows | {"begun": end.cost - fit.best.cost, "own": own}


def true_values(truth) -> dict[str, float]:
    """Return the truth in the words of the ship that is fitted: half a sampling period stands in T_d, as a hold."""
    true = dict(truth["parameters"])
    period = true.get("T_s") or 0.0
    true["vK_p"] += (true.get("update", 0.0) - 0.5) * period * true["vK_i"]
    true["T_d"] += 0.5 * period
    true["hold"] = min(max(0.5 * period / max(true["T_d"], 1e-9), 0.01), 1.0)
    if true.get("damping"):
        # A load that is a straight line, beside the power of the speed that is fitted.
        true["p"] += true["damping"]
        true["c_2"] = (true.get("c_2") or 0.0) - 0.5 * true["p"] * (true["p"] - 1.0)
    off = {
        "M_max": 5.0,
        "rate": 100.0,
        "tau_twist": 3e-4,
        "zeta_twist": 1.0,
        "M_soft": 1e-3,
        "T_M": 0.0,
        "c_2": 0.0,
    }
    return {name: value for name, value in true.items() if value is not None} | {
        name: value
        for name, value in off.items()
        if true.get(name) is None or (name == "tau_twist" and not true[name])
    }


def at_truth(fit, truth, elements):
    """Return the likelihood whose parameters are held at the truth, but for nuisances, and its best vector."""
    from shipfp_rs.identification.basins import descend
    from shipfp_rs.identification.ship_found import likelihood_of

    values = true_values(truth)
    free = likelihood_of(replace(fit, question=replace(fit.question, fixed={})), elements)
    held = {name: values[name] for name in free.coordinates.names if name in values and name not in NUISANCES}
    c = replace(
        free.coordinates,
        free={name: free.coordinates.free[name] for name in free.coordinates.names if name not in held},
        given={**free.coordinates.given, **held},
    )
    likelihood = replace(free, coordinates=c)
    states = fit.likelihood.coordinates.states_at(fit.best.vector)
    end = descend(likelihood, c.vector(values, states))
    for _ in range(2):
        likelihood = likelihood.resettled_at(end.vector)
        end = descend(likelihood, end.vector)
    return likelihood, end.vector


def begun(fit, truth, elements):
    """Return the likelihood of all that acts, and where a descent from the truth ends."""
    from shipfp_rs.identification.basins import descend
    from shipfp_rs.identification.ship_found import likelihood_of

    held, vector = at_truth(fit, truth, elements)
    likelihood = likelihood_of(replace(fit, question=replace(fit.question, fixed={})), elements)
    likelihood = likelihood.with_noise_of(held)
    states = held.coordinates.states_at(vector)
    start = likelihood.coordinates.vector(held.coordinates.values(vector), states)
    return likelihood, descend(likelihood, start)


if __name__ == "__main__":
    main()
