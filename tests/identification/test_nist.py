"""The search of all ships against certified answers of the NIST Statistical Reference Datasets, from both starts."""

import re
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from shipfp_rs.errors import SimulationError
from shipfp_rs.identification.basins import descend
from shipfp_rs.identification.likelihood import Products

FOLDER = Path(__file__).parents[1] / "data" / "nist_strd"


def exponentials(b, x):
    return b[0] * np.exp(-b[1] * x) + b[2] * np.exp(-b[3] * x) + b[4] * np.exp(-b[5] * x)


def peaks(b, x):
    first = b[2] * np.exp(-(((x - b[3]) / b[4]) ** 2))
    second = b[5] * np.exp(-(((x - b[6]) / b[7]) ** 2))
    return b[0] * np.exp(-b[1] * x) + first + second


def cubic_over_cubic(b, x):
    return (b[0] + x * (b[1] + x * (b[2] + x * b[3]))) / (1 + x * (b[4] + x * (b[5] + x * b[6])))


def southern_oscillation(b, x):
    def wave(cosine, sine, period):
        angle = 2 * np.pi * x / period
        return cosine * np.cos(angle) + sine * np.sin(angle)

    return b[0] + wave(b[1], b[2], 12) + wave(b[4], b[5], b[3]) + wave(b[7], b[8], b[6])


MODELS = {
    "Bennett5": lambda b, x: b[0] * (b[1] + x) ** (-1 / b[2]),
    "BoxBOD": lambda b, x: b[0] * (1 - np.exp(-b[1] * x)),
    "Chwirut1": lambda b, x: np.exp(-b[0] * x) / (b[1] + b[2] * x),
    "Chwirut2": lambda b, x: np.exp(-b[0] * x) / (b[1] + b[2] * x),
    "DanWood": lambda b, x: b[0] * x ** b[1],
    "ENSO": southern_oscillation,
    "Eckerle4": lambda b, x: b[0] / b[1] * np.exp(-0.5 * ((x - b[2]) / b[1]) ** 2),
    "Gauss1": peaks,
    "Gauss2": peaks,
    "Gauss3": peaks,
    "Hahn1": cubic_over_cubic,
    "Kirby2": lambda b, x: (b[0] + x * (b[1] + x * b[2])) / (1 + x * (b[3] + x * b[4])),
    "Lanczos1": exponentials,
    "Lanczos2": exponentials,
    "Lanczos3": exponentials,
    "MGH09": lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
    "MGH10": lambda b, x: b[0] * np.exp(b[1] / (x + b[2])),
    "MGH17": lambda b, x: b[0] + b[1] * np.exp(-x * b[3]) + b[2] * np.exp(-x * b[4]),
    "Misra1a": lambda b, x: b[0] * (1 - np.exp(-b[1] * x)),
    "Misra1b": lambda b, x: b[0] * (1 - (1 + b[1] * x / 2) ** -2),
    "Misra1c": lambda b, x: b[0] * (1 - (1 + 2 * b[1] * x) ** -0.5),
    "Misra1d": lambda b, x: b[0] * b[1] * x / (1 + b[1] * x),
    "Nelson": lambda b, x: b[0] - b[1] * x[0] * np.exp(-b[2] * x[1]),
    "Rat42": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)),
    "Rat43": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)) ** (1 / b[3]),
    "Roszman1": lambda b, x: b[0] - b[1] * x - np.arctan(b[2] / (x - b[3])) / np.pi,
    "Thurber": cubic_over_cubic,
}


@dataclass(frozen=True)
class Problem:
    """One dataset with its certified answer; `function` gives residuals."""

    name: str
    starts: tuple[np.ndarray, np.ndarray]
    certified: np.ndarray
    deviations: np.ndarray
    sum_of_squares: float
    residual_deviation: float
    y: np.ndarray
    x: np.ndarray

    @classmethod
    def read(cls, name):
        text = (FOLDER / f"{name}.dat").read_text(encoding="ascii")
        rows = re.findall(r"^\s*b\d+ =\s+(\S+)\s+(\S+)\s+(\S+)\s+(\S+)", text, re.MULTILINE)
        starts_and_answer = np.array(rows, dtype=np.float64).T
        first, last = map(int, re.search(r"Data\s+\(lines (\d+) to (\d+)\)", text).groups())
        # Extended precision where the platform has it: the residuals of Lanczos1 are 1e-13 of the data.
        y, *x = (
            np.array([line.split() for line in text.splitlines()[first - 1 : last]]).astype(np.longdouble).T
        )
        return cls(
            name,
            (starts_and_answer[0], starts_and_answer[1]),
            starts_and_answer[2],
            starts_and_answer[3],
            float(re.search(r"Residual Sum of Squares:\s+(\S+)", text)[1]),
            float(re.search(r"Residual Standard Deviation:\s+(\S+)", text)[1]),
            np.log(y) if name == "Nelson" else y,
            x[0] if len(x) == 1 else np.array(x),
        )

    def function(self, vector):
        """Residual and its Jacobian; complex step is exact for these models."""
        model = MODELS[self.name]
        with np.errstate(all="ignore"):
            residual = (self.y - model(vector, self.x)).astype(np.float64)
            steps = vector + 1e-30j * np.eye(len(vector))
            x = self.x.astype(np.float64)
            jacobian = np.array([-model(step, x).imag / 1e-30 for step in steps]).T
        return residual, jacobian.astype(np.float64)


def agreeing(found, certified):
    """Smallest number of agreeing digits, -log10 of the relative error; NIST certifies 11."""
    error = np.abs(np.asarray(found) - certified) / np.abs(certified)
    return float(np.min(-np.log10(np.maximum(error, 1e-11))))


ASTRAY = {("BoxBOD", 1), ("MGH10", 1), ("MGH17", 1)}
"""The far start of these leads to where a term has no effect, a minimum at infinity: one descent finds no way back."""


class Squares:
    """A dataset in place of a likelihood, in units of its certified residual."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        size = len(problem.certified)
        self.coordinates = SimpleNamespace(bounds=(np.full(size, -np.inf), np.full(size, np.inf)))

    def near(self, vector):
        return self

    def products(self, vector: np.ndarray) -> Products:
        residual, jacobian = self.problem.function(vector)
        residual, rows = (part / self.problem.residual_deviation for part in (residual, -jacobian.T))
        with np.errstate(all="ignore"):
            found = Products(float(residual @ residual), rows @ residual, rows @ rows.T)
        if not np.isfinite(found.cost) or not np.isfinite(found.matrix).all():
            raise SimulationError("a residual is not finite")
        return found


CASES = [(name, start) for name in MODELS for start in (1, 2) if (name, start) not in ASTRAY]


@pytest.mark.parametrize(("name", "start"), CASES)
def test_certified_answer_is_found(name, start):
    problem = Problem.read(name)
    found = descend(Squares(problem), problem.starts[start - 1], steps=5000, settled=1e-9)
    # A step that lowers the sum of squares by a part of 1e-9 of the noise counts no more.
    assert agreeing(found.vector, problem.certified) > 4.5
