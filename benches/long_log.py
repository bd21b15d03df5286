"""A simulated log as long as the full-scale trial's Run2: five channels at 2 kHz for 3.2 hours, made piece by piece.

The schedule is that of Table 6.7: sines, steps and chirps of 0.6 V peak to peak with pauses between. The plant is
stepped at 200 Hz and what a logger's 16-bit converter would see of it is made in pieces of a minute or so, so that
114 million samples take seconds and little memory.
"""

from collections.abc import Iterator

import numpy as np

from shipfp_rs import published, signals
from shipfp_rs.logs.log import Channel, Log
from shipfp_rs.simulation.raw_log import Sensors
from shipfp_rs.simulation.simulate import simulate
from shipfp_rs.vessel.vessel import Vessel

SHIP = "stan-tug-1205"
RUN2_S = 11_450.0
PLANT_HZ = 200.0
RATE_HZ = 2000.0
AMPLITUDE_RPM = 76.0
LSB_V = 20.0 / 2**16
"""Step of a 16-bit converter of plus and minus 10 V."""
PIECE = 1 << 17


def run2_windows() -> list[tuple[str, str, float, float]]:
    """Name, kind, start and stop [s] of the experiments of Run2 (Table 6.7), in order of time."""
    rows = [row for row in published.full_scale_experiments() if row.jvs_file == "Run2"]
    kinds = {"step": "steps"}
    return sorted(
        (
            (row.name, kinds.get(row.kind, row.kind), float(row.jvs_start_s), float(row.jvs_stop_s))
            for row in rows
        ),
        key=lambda row: row[2],
    )


def set_point(duration_s: float) -> np.ndarray:
    """Deviations of the set point [rpm] at `PLANT_HZ`, the schedule squeezed into the duration."""
    squeeze = duration_s / RUN2_S
    deviation = np.zeros(round(duration_s * PLANT_HZ))
    facts = {row.name: row for row in published.full_scale_experiments()}
    for name, kind, start_s, stop_s in run2_windows():
        row, length = facts[name], (stop_s - start_s) * squeeze
        if kind == "sine":
            time = np.arange(round(length * PLANT_HZ)) / PLANT_HZ
            samples = AMPLITUDE_RPM * np.sin(2 * np.pi * row.frequency_hz * time)
        elif kind == "chirp":
            samples = signals.chirp(
                row.frequency_hz, row.stop_frequency_hz, length, AMPLITUDE_RPM, rate_hz=PLANT_HZ
            ).samples
        else:
            samples = signals.steps([80.0, 80.0, -80.0, -80.0], length / 4, rate_hz=PLANT_HZ).samples
        first = round(start_s * squeeze * PLANT_HZ)
        deviation[first : first + len(samples)] = samples[: len(deviation) - first]
    return deviation


def long_log(duration_s: float = RUN2_S, seed: int = 0) -> Log:
    """Return the log; its samples are made while it is written."""
    ship, sensors = Vessel.load(SHIP), Sensors()
    excitation = signals.Excitation("Run2", "joined", PLANT_HZ, set_point(duration_s))
    plant = simulate(ship, excitation).signals
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (plant["n_s"][1:] + plant["n_s"][:-1]) / PLANT_HZ)])
    gear = ship.gearbox.ratio
    orders = (1.0, ship.propeller.blades, gear, gear * ship.engine.cylinders / (ship.engine.strokes / 2))
    samples = round(duration_s * RATE_HZ)

    def pulses(angle: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Trapezoids of 30 % of the pitch, their edges a few degrees wide."""
        pitch = 1.0 / len(places)
        corner = np.array([0.0, 0.02, 0.3, 0.32]) * pitch
        at = np.append((places[:, None] + corner).ravel(), 1.0)
        volts = np.append(np.tile([0.0, 5.0, 5.0, 0.0], len(places)), 0.0)
        return np.interp(angle % 1.0, at, volts)

    def volts(channel: str, first: int, count: int) -> np.ndarray:
        # Seeded by place: whoever reads from any row on sees the same noise.
        noise = np.random.default_rng([seed, sum(channel.encode()), first // PIECE])
        time = np.arange(first, first + count) * (PLANT_HZ / RATE_HZ)
        white = noise.standard_normal(count, dtype=np.float32)
        below = np.minimum(time.astype(np.int64), len(turned) - 2)
        share = time - below
        if channel == "U_setpoint":
            n_set = plant["n_set"][np.minimum(below, len(turned) - 1)]
            return sensors.set_point.inverse(n_set) + sensors.set_point_noise_V * white
        n_s = plant["n_s"]
        # Speed in straight lines between the plant's samples, so its angle in parabolas.
        angle = turned[below] + share / PLANT_HZ * (n_s[below] + 0.5 * share * (n_s[below + 1] - n_s[below]))
        if channel == "U_torque":
            M_g = plant["M_g"]
            torque = M_g[below] + share * (M_g[below + 1] - M_g[below])
            for amplitude, order in zip(sensors.ripple_Nm, orders, strict=True):
                torque += amplitude * np.sin(2 * np.pi * order * angle)
            clean = sensors.torque.inverse(torque) + sensors.torque_noise_V * white
            # Radio interference, three times a minute and 20 ms long.
            struck = (np.arange(first, first + count) + 7919) % 40_000 < 40
            return np.where(struck, sensors.receiver_limit_V, clean)
        train = {
            "PTM_1": (angle, np.zeros(1)),
            "PTM_4": (angle, (np.arange(4) + np.array(sensors.reflector_errors)) / 4.0),
            "PTM_e": (gear * angle, np.zeros(1)),
        }[channel]
        return pulses(*train) + sensors.pulse_noise_V * white

    def blocks(channel: str, first: int, size: int) -> Iterator[np.ndarray]:
        for start in range(first, samples, PIECE):
            block = volts(channel, start, min(PIECE, samples - start))
            yield (np.rint(block / LSB_V) * LSB_V).astype(np.float32)

    names = ("U_setpoint", "U_torque", "PTM_1", "PTM_4", "PTM_e")
    return Log("Run2", [Channel(name, "V", RATE_HZ, samples) for name in names], blocks)


def trial_text(log: str, duration_s: float = RUN2_S) -> str:
    """TRIAL.toml whose windows cover the whole log: each runs up to the next one's start."""
    squeeze = duration_s / RUN2_S
    found = run2_windows()
    stops = [start for _, _, start, _ in found[1:]] + [RUN2_S]
    windows = "".join(
        f'\n[[windows]]\nname = "{name}"\nkind = "{kind}"\nstart_s = {start * squeeze}\nstop_s = {stop * squeeze}\n'
        for (name, kind, start, _), stop in zip(found, stops, strict=True)
    )
    sensors = Sensors()
    trains = "".join(
        f'\n[channels.{name}]\ncolumn = "{name}"\npulses_per_rev = {pulses}\nshaft = "{shaft}"\n'
        for name, pulses, shaft in (
            ("PTM_1", 1, "propeller"),
            ("PTM_4", 4, "propeller"),
            ("PTM_e", 1, "engine"),
        )
    )
    return f"""\
[trial]
name = "Run2, simulated"
vessel = "{SHIP}"
log = "{log}"

[channels.set_point]
column = "U_setpoint"
unit = "V"
calibration = {{ scale = {sensors.set_point.scale}, offset = {sensors.set_point.offset} }}

[channels.torque]
column = "U_torque"
unit = "V"
calibration = {{ scale = {sensors.torque.scale}, offset = {sensors.torque.offset} }}
location = "gauge"
{trains}
[operating_point]
n_e_rpm = "auto"
M_Nm = "auto"
steady_s = [0.0, {400.0 * squeeze}]
{windows}"""
