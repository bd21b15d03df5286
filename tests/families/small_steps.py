"""Fixed small steps: the drive train in physical units by fourth-order Runge-Kutta, cut where a sampling governor acts.

Set point, water and load are given every half step, straight lines between. A rigid shaft has one speed. The governor's
command reaches the rack a dead time later: for a governor that does not sample, straight lines between its values at the
steps; for one that does, the very values at the very instants. A rack without a lag that can't follow its command goes
at its fastest until it has caught up.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from tests.families.excitations import Excitation
from tests.families.plant import Plant

TWO_PI = 2.0 * np.pi


class Motion(NamedTuple):
    """What happened, at every step, shape (N,) each."""

    step_s: float
    asked: np.ndarray
    """Set point at the lever [rev/s of the engine]."""
    engine_speed: np.ndarray
    """[rev/s] of the engine."""
    load_speed: np.ndarray
    """[rev/s] of the shaft behind the gauge."""
    brake_torque: np.ndarray
    """[Nm] of the engine."""
    gauge_torque: np.ndarray
    """[Nm] of the shaft, between the inertias."""
    load_torque: np.ndarray
    """External load, without the load's own law [Nm of the shaft]."""


@njit(cache=True, inline="always")
def _brake(plant, speed, rack):
    free = (
        plant.shaft_torque / (plant.ratio * plant.efficiency)
        + plant.engine_slope * (speed * plant.ratio - plant.engine_speed)
        + plant.rack_slope * (rack - plant.rack)
    )
    return min(free, plant.limit)


@njit(cache=True, inline="always")
def _load(plant, speed, water, load):
    n0 = plant.engine_speed / plant.ratio
    exponent = plant.exponent + plant.exponent_drift * (speed / n0 - 1.0)
    share = 1.0 if exponent == 0.0 else (speed / n0) ** exponent
    return plant.shaft_torque * share * (1.0 + water) + plant.load_damping * (speed - n0) + load


@njit(cache=True, inline="always")
def _rates(plant, first, second, spring, rack, command, water, load):
    drive = _brake(plant, first, rack) * plant.ratio * plant.efficiency
    moved = 0.0
    if plant.lag > 0.0:
        moved = min(max((command - rack) / plant.lag, -plant.rack_rate), plant.rack_rate)
    if plant.stiffness == 0.0:
        rate = (drive - _load(plant, first, water, load)) / (
            TWO_PI * (plant.engine_inertia + plant.load_inertia)
        )
        return rate, rate, 0.0, moved
    through = spring + plant.shaft_damping * TWO_PI * (first - second)
    return (
        (drive - through) / (TWO_PI * plant.engine_inertia),
        (through - _load(plant, second, water, load)) / (TWO_PI * plant.load_inertia),
        plant.stiffness * TWO_PI * (first - second),
        moved,
    )


@njit(cache=True, inline="always")
def _reached(plant, rack, command, ahead):
    """Rack without a lag some time after it stood at `rack`: at its command, or on the way there at its fastest."""
    way = plant.rack_rate * ahead if ahead > 0.0 else 0.0
    return min(max(command, rack - way), rack + way)


@njit(cache=True, inline="always")
def _between(table, at):
    """Straight line through a table every half step; before its begin the first value."""
    if at <= 0.0:
        return table[0]
    i = int(at)
    if i >= len(table) - 1:
        return table[-1]
    return table[i] + (at - i) * (table[i + 1] - table[i])


@njit(cache=True, inline="always")
def _late(commands, at, last):
    """Command at a step that lies back, straight lines between steps; before the record the first command."""
    if at <= 0.0:
        return commands[0]
    i = int(at)
    if i >= last:
        return commands[last]
    return commands[i] + (at - i) * (commands[i + 1] - commands[i])


@njit(cache=True, inline="always")
def _command(plant, first, total, time, h, asked, commands, k, held):
    """Command that reaches the actuator, and the error that the governor's sum grows by."""
    if plant.period > 0.0:
        return held, 0.0
    error = _between(asked, (time - plant.set_point_dead_time) / (h / 2.0)) - first * plant.ratio
    if plant.dead_time > 0.0:
        return _late(commands, (time - plant.dead_time) / h, k), error
    return plant.rack + plant.gain * error + plant.integral_gain * total, error


@njit(cache=True)
def _stepped(plant, first, second, spring, rack, total, now, d, h, asked, water, load, commands, k, held):
    """State after a classical Runge-Kutta step of length `d`; `held` is the command of a governor that samples."""
    a1 = a2 = a3 = a4 = a5 = 0.0
    s1 = s2 = s3 = s4 = s5 = 0.0
    half = h / 2.0
    for stage in range(4):
        ahead = 0.0 if stage == 0 else (d if stage == 3 else 0.5 * d)
        weight = d / 6.0 if stage in (0, 3) else d / 3.0
        time = now + ahead
        x1, x2, x3 = first + ahead * s1, second + ahead * s2, spring + ahead * s3
        x4, x5 = rack + ahead * s4, total + ahead * s5
        command, s5 = _command(plant, x1, x5, time, h, asked, commands, k, held)
        if plant.lag == 0.0:
            x4 = command if plant.rack_rate == np.inf else _reached(plant, rack, command, ahead)
        s1, s2, s3, s4 = _rates(
            plant, x1, x2, x3, x4, command, _between(water, time / half), _between(load, time / half)
        )
        a1 += weight * s1
        a2 += weight * s2
        a3 += weight * s3
        a4 += weight * s4
        a5 += weight * s5
    first, second, spring, total = first + a1, second + a2, spring + a3, total + a5
    if plant.lag > 0.0:
        return first, second, spring, rack + a4, total
    command, _ = _command(plant, first, total, now + d, h, asked, commands, k, held)
    return first, second, spring, _reached(plant, rack, command, d), total


@njit(cache=True)
def _march(plant, asked, water, load, h, count):
    out = np.empty((4, count))
    first = second = plant.engine_speed / plant.ratio
    spring, rack, total = plant.shaft_torque, plant.rack, 0.0
    samples = plant.period > 0.0
    room = int(count * h / plant.period) + 3 if samples else count
    commands = np.full(room, plant.rack)
    taken, arrived, held = 0, 0, plant.rack
    tiny = 1e-9 * h
    half = h / 2.0
    for k in range(count):
        now, end = k * h, (k + 1) * h
        while True:
            if samples:
                while taken < room and now >= plant.phase + taken * plant.period - tiny:
                    error = _between(asked, (now - plant.set_point_dead_time) / half) - first * plant.ratio
                    if plant.sums_first > 0.0:
                        total += plant.period * error
                    commands[taken] = plant.rack + plant.gain * error + plant.integral_gain * total
                    if plant.sums_first == 0.0:
                        total += plant.period * error
                    taken += 1
                while (
                    arrived < taken and now >= plant.phase + arrived * plant.period + plant.dead_time - tiny
                ):
                    held = commands[arrived]
                    arrived += 1
            else:
                error = _between(asked, (now - plant.set_point_dead_time) / half) - first * plant.ratio
                commands[k] = plant.rack + plant.gain * error + plant.integral_gain * total
                held = _late(commands, (now - plant.dead_time) / h, k)
            if plant.lag == 0.0 and plant.rack_rate == np.inf:
                rack = held
            if now == k * h:
                now_load = _between(load, 2.0 * k)
                now_water = _between(water, 2.0 * k)
                rate = _rates(plant, first, second, spring, rack, held, now_water, now_load)
                out[0, k] = first * plant.ratio
                out[1, k] = second
                out[2, k] = _brake(plant, first, rack)
                if plant.stiffness == 0.0:
                    out[3, k] = (
                        _load(plant, first, now_water, now_load) + TWO_PI * plant.load_inertia * rate[0]
                    )
                else:
                    out[3, k] = spring + plant.shaft_damping * TWO_PI * (first - second)
            stop = end
            if samples:
                stop = min(stop, plant.phase + taken * plant.period)
                if arrived < taken:
                    stop = min(stop, plant.phase + arrived * plant.period + plant.dead_time)
            d = stop - now
            first, second, spring, rack, total = _stepped(
                plant, first, second, spring, rack, total, now, d, h, asked, water, load, commands, k, held
            )
            now = stop
            if now >= end - tiny:
                break
    return out


def _seen(set_point, times):
    return (
        set_point.mean(times, times[1] - times[0]) if isinstance(set_point, Excitation) else set_point(times)
    )


def simulate(plant: Plant, set_point, seconds: float, *, step_s: float, water=None, load=None) -> Motion:
    """Run a drive train from its operating point.

    Parameters
    ----------
    plant
        The drive train.
    set_point, water, load
        Functions of times [s]: set point over the steady one, relative change of the load's law, external load [Nm]. An
        `Excitation` is averaged about each instant, so that a step keeps its time to less than a step of the simulation.
    seconds, step_s
        How long and in which steps; a dead time of the loop must not be shorter than a step.
    """
    if 0.0 < plant.dead_time < step_s:
        raise ValueError(f"dead time {plant.dead_time} s is shorter than the step {step_s} s")
    count = round(seconds / step_s)
    times = np.arange(2 * count + 1) * (step_s / 2.0)
    nothing = np.zeros(2)
    asked, heard = (
        plant.engine_speed * _seen(set_point, times),
        plant.engine_speed * _seen(set_point, times[: 2 * count : 2]),
    )
    pushed = nothing if load is None else load(times)
    out = _march(plant, asked, nothing if water is None else water(times), pushed, step_s, count)
    return Motion(step_s, heard, *out, np.zeros(count) if load is None else pushed[: 2 * count : 2])
