"""NumPy reference of the two equations in tapered spectra, written from the equations.

With D for the step to the next derivative of the taper, an operator H(s) acts on the spectra of a signal as H(s + D). So an
operator is the list of its Taylor coefficients in s, [4, F]. Parameters may be complex: derivatives are Cauchy's integrals.
"""

from math import comb, factorial

import numpy as np
from numpy.polynomial import Polynomial as P

from shipfp_rs import _core

NAMES = _core.EQUATION_PARAMETERS
ORDERS = 4
POINTS, RADIUS = 8, 0.01
PERIODS = 0.5
LEAST_DAMPED = 0.01


def times(a, b):
    """The product of two operators."""
    return np.array([sum(a[j] * b[k - j] for j in range(k + 1)) for k in range(ORDERS)])


def product(*operators):
    found = operators[0]
    for one in operators[1:]:
        found = times(found, one)
    return found


def polynomial(s, *coefficients):
    orders = np.zeros((ORDERS, len(s)), complex)
    for k in range(min(ORDERS, len(coefficients))):
        taylor = [comb(n, k) * one for n, one in enumerate(coefficients) if n >= k]
        orders[k] = np.polyval(taylor[::-1], s)
    return orders


def delay(s, t):
    return np.exp(-s * t) * np.array([1.0, -t, t**2 / 2, -(t**3) / 6])[:, None]


def acting(operator, orders):
    """All orders of a signal behind an operator."""
    found = np.zeros(orders.shape, complex)
    for k in range(ORDERS):
        for j in range(ORDERS - k):
            found[k] += operator[j] * orders[k + j]
    return found


def ripple(period, dead, lag):
    """What a governor sees of its own stairs, over the fuel's slope and one over the inertia, behind a lag."""
    late = dead / period - 0.5
    if late.real >= 2.0 * PERIODS:
        return 0.0
    y = 1.0 - late
    found = -0.5 * period**2 * (y * y - y + 1.0 / 6.0) + lag * period * (y - 0.5)
    if lag != 0.0:
        found += lag * period * np.exp(-y * period / lag) / (1.0 - np.exp(-period / lag)) - lag**2
    part = late / PERIODS - 1.0 if late.real > PERIODS else 0.0
    return found * (1.0 - 3.0 * part**2 + 2.0 * part**3)


def residuals(parameters, signals, spacing, late, outputs, gauge, open_loop):
    """Residuals (O, F) of measured outputs; `late` has for each signal its spectra and the delay that these have."""
    q = dict(zip(NAMES, parameters, strict=True))
    spectra = dict(zip(_core.EQUATION_SIGNALS, signals[:, :, 0] + 1j * signals[:, :, 1], strict=True))
    (late_n, speed_grid), (late_u, set_grid), *late_torque = (
        (part[:, 0] + 1j * part[:, 1], grid) for part, grid in late
    )
    propeller = bool(late_torque)
    s = 1j * spacing * np.arange(signals.shape[3])
    one = polynomial(s, 1.0)
    zero = 0.0 * one

    # The channels: late themselves, the torque of another scale.
    early = delay(s, -q["T_n"])
    N, N2, N3 = (acting(early, spectra[name]) for name in ("N", "N2", "N3"))
    early_torque = delay(s, -q["T_M"])

    def scaled(torque):
        return (torque + spectra["one"]) / q["s_M"] + (q["m_0"] - 1.0) * spectra["one"]

    M = scaled(acting(early_torque, spectra["M"]))
    brake = acting(delay(s, -q["T_B"]), spectra["M_b"]) + spectra["one"]
    brake = brake / q["s_B"] - spectra["one"]
    apart = q["T_s"] / np.sqrt(12.0)
    held = 0.5 * (delay(s, apart) + delay(s, -apart))
    fed_n = acting(product(delay(s, q["T_d"] - speed_grid), early, held), late_n)
    way = delay(s, q["T_d"] + q["T_set"] - set_grid)
    asked = acting(times(way, held), late_u)
    asked = asked + q["u_0"] * spectra["one"]

    # The load's side: shaft torque of speed and load, a shaft that twists in between.
    s_of, zero = polynomial(s, 0.0, 1.0), 0.0 * one
    law = polynomial(s, q["p"] + q["damping"], q["tau_prop"])
    ahead = (q["tau_n"] - q["tau_prop"]) * s_of
    damped, wind = one + q["zeta_twist"] * q["tau_twist"] * s_of, q["tau_twist"] * s_of
    # The engine's speed times `whole` is the propeller's times `damped`, and the torque times `wound`.
    turned = damped if gauge else damped + times(ahead, wind)
    whole, seen, wound = (turned, damped, wind) if propeller else (one, one, zero)
    flexible = damped + times(law, wind)
    inertia = zero if gauge else ahead
    if propeller:
        by_torque, on_load = (one, one) if gauge else (damped, turned)
        load_n = times(on_load, law) + times(inertia, damped)
    else:
        by_torque, on_load = flexible, damped
        load_n = times(damped, law) + times(inertia, flexible)
    p = q["p"]
    bent = (p * (p - 1) / 2 + q["c_2"]) * N2 + p * (p - 1) * (p - 2) / 6 * N3 + q["k_L"] * spectra["load"]
    load_rest = acting(on_load, bent)
    # The engine's side: brake torque less its own slope is what the fuel makes.
    charged = polynomial(s, 1.0, q["tau_eng"])
    engine_n = (times(charged, ahead) if gauge else zero) - q["g"] * one

    lag = polynomial(s, 1.0, q["tau_act"])
    if open_loop:
        cleared, on_n, on_u = lag, zero, q["v"] * one
    else:
        filtered = polynomial(s, 1.0, q["T_f"])
        faded = polynomial(s, q["droop"] * q["vK_i"], 1.0 + q["droop"] * q["vK_p"])
        cleared = product(faded, lag, filtered)
        half = 0.5 * q["T_s"]
        on_u = polynomial(s, q["vK_i"], q["vK_p"], q["vK_i"] * half**2 / 3.0)
        on_n = on_u + polynomial(s, 0.0, 0.0, q["vK_d"])
        on_u = times(on_u, filtered)
        if half.real and not propeller:
            flexes = q["tau_twist"] * q["tau_prop"] * (2.0 * np.pi / q["T_s"]) ** 2
            near = q["tau_n"] - q["tau_prop"] * flexes / (1.0 + flexes)
            fuel = polynomial(s, 0.0, q["p"] + q["damping"] - q["g"], q["tau_n"])
            lags = q["tau_act"] + q["tau_eng"]
            sees = ripple(q["T_s"], q["T_d"], lags) / near
            on_n = times(on_n, one + sees * times(fuel, polynomial(s, 1.0, lags)))

    columns = sorted(outputs)
    dead = times(delay(s, q["T_d"]), held)[0]
    left, matrix = [], []
    if 1 in outputs:
        left.append(acting(by_torque, M) - acting(load_n, N) - load_rest)
        matrix.append({0: -load_n[0], 1: by_torque[0]})
    fed, on_m = acting(times(on_n, seen), fed_n), times(on_n, wound)
    if propeller:
        late_m, torque_grid = late_torque[0]
        moved = product(delay(s, q["T_d"] - torque_grid), early_torque, held)
        fed = fed + acting(on_m, scaled(acting(moved, late_m)))
    of_torque, of_speed = times(charged, whole) + times(engine_n, wound), times(engine_n, seen)
    if 1 in outputs:
        more = 0.0
        if gauge and q["t_1"].real > 0.0 and 2 not in outputs:
            more = (q["tau_n"] - q["tau_prop"] - q["t_1"]) / (q["tau_prop"] + q["t_1"])
        of_torque = of_torque + more * times(charged, by_torque)
        of_speed = of_speed - more * times(charged, load_n)
        engine, engine_row = acting(of_torque, M) + acting(of_speed, N), {0: of_speed, 1: of_torque}
        engine = engine - more * acting(charged, load_rest)
    else:
        # The load's equation stands for a torque that is not measured.
        engine = acting(times(of_torque, load_n) + of_speed, N) + acting(of_torque, load_rest)
        engine_row = {0: times(of_torque, load_n) + of_speed}
    on_n, on_u = times(on_n, seen), times(on_u, whole)
    fuel = acting(on_u, asked) - fed
    if 2 in outputs:
        X = spectra["X"]
        left.append(engine - acting(q["v"] * whole, X) - q["x_0"] * spectra["one"])
        left.append(acting(q["v"] * times(cleared, whole), X) - fuel)
        matrix.append({**{k: row[0] for k, row in engine_row.items()}, 2: -q["v"] * whole[0]})
        governed = {0: on_n[0] * dead, 2: q["v"] * times(cleared, whole)[0]}
        matrix.append({**governed, 1: on_m[0] * dead} if propeller else governed)
    else:
        if open_loop:
            engine = engine - q["x_0"] * spectra["one"]
        left.append(acting(cleared, engine) - fuel)
        row = {k: times(cleared, operator)[0] for k, operator in engine_row.items()}
        row[0] = row[0] + on_n[0] * dead
        if propeller:
            row[1] = row.get(1, 0.0) + on_m[0] * dead
        matrix.append(row)

    if 3 in outputs:
        # The engine's inertia takes the difference of both torques.
        left.append(acting(whole, brake - M) - acting(ahead, acting(seen, N) + acting(wound, M)))
        matrix.append({0: -times(ahead, seen)[0], 1: -(whole + times(ahead, wound))[0], 3: whole[0]})

    own = {
        0: np.exp(-s * q["T_n"]),
        1: q["s_M"] * np.exp(-s * q["T_M"]),
        2: np.ones_like(s),
        3: q["s_B"] * np.exp(-s * q["T_B"]),
    }
    A = np.array([[row.get(c, 0.0 * s) for c in columns] for row in matrix]).transpose(2, 0, 1)
    found = np.linalg.solve(A, np.array([one_left[0] for one_left in left]).T[..., None])[..., 0].T
    for index, output in enumerate(columns):
        found[index] *= own[output]
    return found[[columns.index(output) for output in outputs]]


def rows(
    parameters,
    signals,
    spacing,
    late,
    outputs,
    gauge,
    open_loop,
    wrt,
):
    """Residuals and derivatives of the model (1 + W, O, F), as the kernel's arguments ask for."""
    at = dict(zip(NAMES, parameters, strict=True))
    delays = at["T_d"], at["T_d"] + at["T_set"], at["T_d"]
    grids = [(part, delay_s - rest) for (part, rest), delay_s in zip(late, delays, strict=False)]

    def of(values):
        return residuals(values, signals, spacing, grids, outputs, gauge, open_loop)

    found = [of(np.array(parameters, dtype=complex))]
    turns = np.exp(2j * np.pi * np.arange(POINTS) / POINTS)
    for by in wrt:
        radius = RADIUS * max(abs(parameters[by]), 0.01 if NAMES[by] == "tau_twist" else 0.1)
        total = 0.0
        for turn in turns:
            moved = np.array(parameters, dtype=complex)
            moved[by] += radius * turn
            total = total + of(moved) / (radius * turn)
        found.append(-total / POINTS)
    return np.array(found)


def products(found, root, shapes, hats):
    """Products of rows (1 + W, O, F) in units of the noise, and of smooth errors with them."""
    turn, bent = (part[:, :, 0] + 1j * part[:, :, 1] for part in (root, shapes))
    columns, outputs, frequencies = found.shape
    white = np.zeros_like(found)
    for f in range(frequencies):
        for c in range(columns):
            white[c, :, f] = turn[:, :, f] @ found[c, :, f]
    gram = np.einsum("caf,daf->cd", white.conj(), white).real
    if not bent.size:
        return gram, np.zeros((0, columns))
    along = np.einsum("abf,caf->cbf", bent.conj(), white)
    errors = np.zeros((outputs, 2, len(hats), columns))
    for c in range(columns):
        for b in range(outputs):
            errors[b, 0, :, c] = hats @ along[c, b].real
            errors[b, 1, :, c] = hats @ along[c, b].imag
    return gram, errors.reshape(-1, columns)


def pade(t, order=7):
    """Return numerator and denominator of a delay's Pade approximant (Golub, Van Loan, "Matrix Computations", 9.3.1)."""
    c = [comb(order, k) * factorial(2 * order - k) / factorial(2 * order) for k in range(order + 1)]
    weights = np.array([value * t**k for k, value in enumerate(c)])
    return (P(weights * (-1.0) ** np.arange(order + 1)), P(weights)) if t else (P([1.0]), P([1.0]))


def loop_roots(parameters):
    """Roots of the closed loop about the operating point, exact without a dead time."""
    q = dict(zip(NAMES, parameters, strict=True))
    law, ahead = P([q["p"] + q["damping"], q["tau_prop"]]), P([0.0, q["tau_n"] - q["tau_prop"]])
    inertias = q["tau_n"] - q["tau_prop"], q["tau_prop"]
    swings = np.sqrt(sum(1.0 / one for one in inertias) / q["tau_twist"]) if q["tau_twist"] else np.inf
    damped = P([1.0, max(q["tau_twist"] * q["zeta_twist"], 2.0 * LEAST_DAMPED / swings)])
    speed = damped + q["tau_twist"] * P([0.0, 1.0]) * law
    charged = P([1.0, q["tau_eng"]])
    plant = (
        (charged * (ahead * speed + damped * law) - q["g"] * speed)
        * P([1.0, q["tau_act"]])
        * P([1.0, q["T_f"]])
        * P([q["droop"] * q["vK_i"], 1.0 + q["droop"] * q["vK_p"]])
    )
    governor = P([q["vK_i"], q["vK_p"], q["vK_d"]]) * speed
    apart = q["T_s"] / np.sqrt(12.0)
    (first, under), (second, below) = pade(q["T_d"] - apart), pade(q["T_d"] + apart)
    whole = plant * under * below + 0.5 * governor * (first * below + second * under)
    return whole.trim(1e-300).roots()
