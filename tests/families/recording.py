"""What the families' loggers have in common: a set point in volts, a torque in volts, any number of pulse trains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.families import sensors


def angles(draw, motion):
    """Return the angle of shaft and engine at every step [turns]."""
    shaft = np.cumsum(motion.engine_speed) * motion.step_s / draw.plant.ratio + draw.random(4).random()
    return shaft, shaft * draw.plant.ratio


def begun(draw, samples_a_step):
    """Return what a recording at 2 or 5 kHz begins with: random numbers, rate, motion, angles of shaft and engine."""
    random = draw.random(3)
    rate = float(random.choice([2000.0, 5000.0]))
    motion = draw.motion(samples_a_step / rate)
    return random, rate, motion, *angles(draw, motion)


def faults(random) -> sensors.Faults:
    """Draw how often radio and relay strike, and the hum."""
    return sensors.Faults(
        spikes=int(random.integers(0, 30)),
        jumps=int(random.integers(0, 6)),
        hum_V=float(random.choice([0.0, 0.005, 0.02])),
    )


def logged(draw, motion, random, *, every, torque, trains, telemetry, found, extra=()):
    """Return the log: channels and their tables.

    Parameters
    ----------
    draw, motion, random
        The trial, what happened, the stream of the sensors.
    every
        Steps of the simulation to a sample of the log.
    torque
        At the torque meter, ripple included, at every step of the simulation [Nm].
    trains
        Name to (angle in turns at every step, sensor, "engine" or "propeller").
    telemetry
        Of the torque.
    found
        Faults.
    extra
        Channels beside: (name, unit, samples, table).
    """
    rate = 1.0 / (every * motion.step_s)
    count = len(motion.asked) // every
    times = np.arange(count) / rate
    quiet = draw.noise_free
    found = replace(found, hum_V=0.0, jumps=0) if "n_set" in quiet else found
    found = replace(found, spikes=0) if "torque" in quiet else found
    line, offset = float(random.uniform(-270.0, -230.0)), float(random.uniform(-120.0, -50.0))
    if draw.family in ("genset", "lab_drive"):
        line, offset = -line, -offset
    mean = draw.plant.shaft_torque if draw.place == "gauge" else draw.plant.brake_torque
    per_volt = float(10.0 ** np.ceil(np.log10(mean)) / 4.0)
    rpm = 60.0 * motion.asked[::every][:count]
    heard = telemetry(torque, motion.step_s)[::every][:count]
    columns = {
        "U_setpoint": sensors.set_point_volts(
            rpm, line, offset, rate, random, found, noise_V=0.0 if "n_set" in quiet else 1.5e-3
        ),
        "U_torque": sensors.torque_volts(
            heard, per_volt, rate, random, found, noise_V=0.0 if "torque" in quiet else 2e-3
        ),
    }
    tables = [
        '[channels.set_point]\ncolumn = "U_setpoint"\nunit = "V"\n'
        f"calibration = {{ scale = {line:.6f}, offset = {offset:.6f} }}",
        '[channels.torque]\ncolumn = "U_torque"\nunit = "V"\n'
        f'calibration = {{ scale = {per_volt:.6f} }}\nlocation = "{draw.place}"',
    ]
    units = dict.fromkeys(columns, "V")
    for name, (turns, sensor, shaft) in trains.items():
        sensor = replace(sensor, noise=0.0, double=0.0, broken=0.0) if "n_e" in quiet else sensor
        columns[name], units[name] = sensor(turns, motion.step_s, times, random), "V"
        tables.append(
            f'[channels.{name}]\ncolumn = "{name}"\npulses_per_rev = {len(sensor.positions)}\nshaft = "{shaft}"'
        )
    for name, unit, samples, table in extra:
        columns[name], units[name] = samples[::every][:count].astype(np.float32), unit
        tables.append(table)
    # A sample of the log is at the end of its period, and so half a period less late than the held value is on average.
    facts = {"T_M": telemetry.delay_s - 0.5 / rate, "faults": dict(found.__dict__)}
    return sensors.RawLog(rate, columns, units, "\n\n".join(tables), draw.plant.ratio, facts)


def trial_toml(draw, log: sensors.RawLog, *, path: str, vessel: str) -> str:
    """Return TRIAL.toml: channels, calibrations, the steady stretch and one window; nothing of how to identify."""
    start, stop = draw.excitation.start_s, draw.excitation.stop_s
    begin = start - 5.0 if draw.late_s is None else start + draw.late_s
    return "\n\n".join(
        [
            f'[trial]\nname = "{draw.family} {draw.seed}"\nvessel = "{vessel}"\nlog = "{path}"\nrate_hz = {log.rate_hz}',
            log.tables,
            f"[operating_point]\nsteady_s = [2.0, {start - 1.0:.2f}]",
            f'[[windows]]\nname = "W1"\nkind = "{draw.excitation.kind}"\n'
            f"start_s = {begin:.2f}\nstop_s = {stop - 1.0:.2f}\n",
        ]
    )


def vessel_toml(draw) -> str:
    """Return a vessel file with the gear ratio, and speed and torque as read off a display; the rest suits any ship.

    None of it tells the truth of what is to be identified.
    """
    plant = draw.plant
    rpm = round(60.0 * plant.engine_speed, -1)
    torque = float(f"{plant.brake_torque:.1g}")
    rated = round(1.4 * rpm, -2)
    power = float(f"{2.5 * torque * rated * np.pi / 30e3:.2g}")
    turning = 2.0 * np.pi * (rpm / 60.0 / plant.ratio) / (torque * plant.ratio)
    return f"""name = "A drive train"
[water]
density_kg_m3 = 1000.0
[engine]
model = "unknown"
cylinders = 6
strokes = 4
rated_power_kW = {power}
rated_speed_rpm = {rated}
[gearbox]
ratio = {plant.ratio}
efficiency = 1.0
[shaft]
inertia_kg_m2 = {1.0 / turning:.3g}
propeller_side_inertia_kg_m2 = {0.4 / turning:.3g}
[propeller]
diameter_m = 1.0
pitch_ratio = 1.0
area_ratio = 0.7
blades = 4
torque_exponent = 2.0
K_T = 0.5
[governor]
K_p = 3.0
K_i = 6.0
[operating_point]
n_e_rpm = {rpm}
X_0_mm = 10.0
M_b_Nm = {torque}
v = 1.0
g = -0.5
"""


def write(draw, folder, *, form: str = "parquet"):
    """Write log, vessel and TRIAL.toml of a draw into a folder; return the path of TRIAL.toml and the log."""
    import pyarrow as pa
    import pyarrow.csv
    import pyarrow.parquet

    log = draw.raw()
    table = pa.table({f"{name} [{log.units[name]}]": samples for name, samples in log.columns.items()})
    if form == "parquet":
        pa.parquet.write_table(table, folder / "log.parquet")
    else:
        pa.csv.write_csv(table, folder / "log.csv")
    (folder / "vessel.toml").write_text(vessel_toml(draw), encoding="utf-8")
    trial = folder / "TRIAL.toml"
    trial.write_text(trial_toml(draw, log, path=f"log.{form}", vessel="vessel.toml"), encoding="utf-8")
    return trial, log
