"""What a user would take instead: the plant in JAX, diffrax and SciPy, the linear model elsewhere, a fit by SciPy."""

import os
import shutil
import subprocess
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import least_squares

from benches.bench_plant import acceleration, torque

Array = NDArray[np.float64]


def jax_plant(parameters: Array, n_set: Array, dt: float, substeps: int) -> Callable[[], object] | None:
    """RK4 of all members, as vmap of scan in double precision, compiled; None without JAX."""
    if find_spec("jax") is None:
        return None
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    h = dt / substeps

    def rate(q, u, n, E):
        M_b = jnp.maximum(q[3] * (q[8] + q[9] * (u - q[1] * n) + q[10] * E) + q[4] * q[1] * n + q[5], q[11])
        return (M_b * q[1] * q[2] - q[6] * n * jnp.abs(n)) / (2 * jnp.pi * q[0]), u - q[1] * n

    def run(q):
        def sample(state, u):
            def step(_, state):
                n, E = state
                a1, b1 = rate(q, u, n, E)
                a2, b2 = rate(q, u, n + h / 2 * a1, E + h / 2 * b1)
                a3, b3 = rate(q, u, n + h / 2 * a2, E + h / 2 * b2)
                a4, b4 = rate(q, u, n + h * a3, E + h * b3)
                return n + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4), E + h / 6 * (b1 + 2 * b2 + 2 * b3 + b4)

            X = q[8] + q[9] * (u - q[1] * state[0]) + q[10] * state[1]
            M_b = jnp.maximum(q[3] * X + q[4] * q[1] * state[0] + q[5], q[11])
            return jax.lax.fori_loop(0, substeps, step, state), jnp.stack([*state, X, M_b])

        return jax.lax.scan(sample, (1300.0 / 180.0, 0.0), jnp.asarray(n_set))[1].T

    compiled = jax.jit(jax.vmap(run))
    members = jnp.asarray(parameters)
    return lambda: compiled(members).block_until_ready()


def diffrax_plant(q: Array, n_set: Array, dt: float) -> Callable[[], object] | None:
    """One run by diffrax's Tsit5 with constant steps of a sample; None without diffrax."""
    if find_spec("diffrax") is None:
        return None
    import diffrax
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    q, n_set = jnp.asarray(q), jnp.asarray(n_set)
    times = jnp.arange(len(n_set)) * dt

    def field(t, state, _):
        n, E = state
        u = n_set[jnp.clip(jnp.int64(t / dt + 1e-9), 0, len(n_set) - 1)]
        M_b = jnp.maximum(q[3] * (q[8] + q[9] * (u - q[1] * n) + q[10] * E) + q[4] * q[1] * n + q[5], q[11])
        return jnp.stack([(M_b * q[1] * q[2] - q[6] * n * jnp.abs(n)) / (2 * jnp.pi * q[0]), u - q[1] * n])

    def run(start):
        return diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            diffrax.Tsit5(),
            times[0],
            times[-1],
            dt,
            start,
            saveat=diffrax.SaveAt(ts=times),
            max_steps=len(n_set) + 1,
        ).ys

    compiled, start = jax.jit(run), jnp.array([1300.0 / 180.0, 0.0])
    return lambda: compiled(start).block_until_ready()


def solve_ivp_plant(q: Array, n_set: Array, dt: float) -> Callable[[], object]:
    """One run by SciPy's RK45, which has to be told of every corner of the set point: interval by interval."""
    none = np.empty(0)

    def run():
        state = [1300.0 / 180.0, 0.0]
        for u in n_set:
            state = solve_ivp(
                lambda _, x, u=u: (acceleration(q, torque(q, none, none, u, *x), x[0]), u - q[1] * x[0]),
                (0.0, dt),
                state,
                rtol=1e-6,
            ).y[:, -1]

    return run


def control_outputs(
    A: Array, B: Array, C: Array, D: Array, dn_set: Array, dt: float
) -> Callable[[], object] | None:
    """python-control's forced response; None without it."""
    if find_spec("control") is None:
        return None
    import control

    system, time = control.ss(A, B, C, D), np.arange(dn_set.size) * dt
    return lambda: control.forced_response(system, time, dn_set).outputs


OCTAVE = """pkg load control; u = cos((1:%(samples)d)' / 50); t = (0:%(samples)d - 1)' * %(dt)g;
s = ss(%(A)s, %(B)s, %(C)s, %(D)s); lsim(s, u, t); c = cputime; for k = 1:3, lsim(s, u, t); end; disp((cputime - c) / 3)"""


def octave_seconds(A: Array, B: Array, C: Array, D: Array, samples: int, dt: float) -> float | None:
    """Processor seconds of one lsim of GNU Octave's control package; None where either is missing."""
    if shutil.which("octave-cli") is None:
        return None

    def text(matrix: Array) -> str:
        return "[" + "; ".join(" ".join(f"{value:.17g}" for value in row) for row in matrix) + "]"

    script = OCTAVE % {
        "samples": samples,
        "dt": dt,
        **{k: text(v) for k, v in zip("ABCD", (A, B, C, D), strict=True)},
    }
    run = subprocess.run(
        ["octave-cli", "-q", "--no-gui", "--eval", script], capture_output=True, text=True, check=False
    )
    try:
        return float(run.stdout)
    except ValueError:
        return None


@njit
def residuals_of(Phi, now, late, q, rates, start, offsets, u, measured, root, out):
    """Weighted residuals of speed and brake torque of the linear drive train, by recurrence."""
    a, b, c = rates
    n, E = start
    last = u.size - 1
    for k in range(u.size):
        e1 = measured[0, k] - n - offsets[0]
        e2 = measured[1, k] - 2.0 * n - q[0] * (-(a + b) * n + c * E + b * u[k]) - offsets[1]
        out[0, k], out[1, k] = root[0, 0] * e1, root[1, 0] * e1 + root[1, 1] * e2
        after = u[k + 1] if k < last else u[k]
        n, E = (
            Phi[0, 0] * n + Phi[0, 1] * E + now[0] * u[k] + late[0] * after,
            Phi[1, 0] * n + Phi[1, 1] * E + now[1] * u[k] + late[1] * after,
        )


class SciPyFit:
    """The fit of four parameters, initial state and offsets by `least_squares` with finite differences, weights iterated.

    What a user writes with SciPy and Numba: the same model, unknowns, bounds and tolerance as `identify` with white noise.
    """

    def __init__(self, dn_set: Array, measured: Array, dt: float):
        self.dn_set, self.measured, self.dt = dn_set, measured, dt
        self.simulations = 0

    def residual(self, x: Array, root: Array) -> Array:
        self.simulations += 1
        tau_n, g, vK_p, vK_i = x[:4]
        rates = a, b, c = (2.0 - g) / tau_n, vK_p / tau_n, vK_i / tau_n
        augmented = np.zeros((4, 4))
        augmented[0, :3], augmented[1, :3] = [-a - b, c, b], [-1.0, 0.0, 1.0]
        augmented[:2] *= self.dt
        augmented[2, 3] = 1.0
        X = expm(augmented)
        out = np.empty_like(self.measured)
        now, late = X[:2, 2] - X[:2, 3], X[:2, 3].copy()
        residuals_of(
            X[:2, :2].copy(), now, late, x[:4], rates, x[4:6], x[6:8], self.dn_set, self.measured, root, out
        )
        return out.ravel()

    def __call__(self) -> tuple[Array, Array]:
        """Return the estimates and their covariance."""
        self.simulations = 0
        x = np.array([1.2, -0.5, 5.0, 5.0, 0.0, 0.0, 0.0, 0.0])
        free = np.full(4, np.inf)
        bounds = np.append([0.01, -10.0, 1e-4, 1e-4], -free), np.append([10.0, 1.0, 1e3, 1e3], free)
        root, before = np.diag(1.0 / self.measured.std(axis=1)), np.inf
        for _ in range(100):
            ended = least_squares(
                self.residual,
                x,
                bounds=bounds,
                x_scale="jac",
                ftol=1e-12,
                xtol=1e-12,
                gtol=1e-12,
                args=(root,),
            )
            x = ended.x
            e = self.residual(x, np.eye(2)).reshape(2, -1)
            scatter = e @ e.T / e.shape[1]
            criterion = e.shape[1] * np.linalg.slogdet(scatter)[1]
            if abs(before - criterion) < 1e-8:
                break
            root, before = np.linalg.inv(np.linalg.cholesky(scatter)), criterion
        return x, np.linalg.inv(ended.jac.T @ ended.jac)
