"""A small trial of the tug as a logger of speed and torque would have written it: a CSV that needs no calibration."""

import io
from functools import cache
from pathlib import Path

import numpy as np

from shipfp_rs import signals
from shipfp_rs.simulation.raw_log import Sensors, simulate_raw_log
from shipfp_rs.vessel.vessel import Vessel

RATE_HZ = 500.0
STEADY_S = 40.0
CHIRP_S = 50.0


def write_csv(path: Path, seed: int = 0) -> Path:
    """Write the log of a tug."""
    path.write_bytes(csv_of(seed))
    return path


@cache
def csv_of(seed: int) -> bytes:
    """Set point [rpm], torque [Nm] and one pulse a turn of the engine [V], with relay jumps and radio spikes."""
    sensors = Sensors(rate_hz=RATE_HZ)
    chirp = signals.chirp(0.04, 1.5, CHIRP_S, 40.0, rate_hz=RATE_HZ, name="chirp")
    log, _ = simulate_raw_log(
        Vessel.load("stan-tug-1205"), chirp, sensors=sensors, faults=("C", "D1"), steady_s=STEADY_S, seed=seed
    )
    columns = (
        np.arange(log.channel("PTM_e").samples) / RATE_HZ,
        sensors.set_point(log.read("U_setpoint")),
        sensors.torque(log.read("U_torque")),
        log.read("PTM_e"),
    )
    text = io.BytesIO()
    np.savetxt(
        text, np.column_stack(columns), fmt=["%.4f", "%.3f", "%.2f", "%.3f"], delimiter=",", comments="",
        header="time [s],n_set [rpm],shaft torque [Nm],PTM_e [V]",
    )  # fmt: skip
    return text.getvalue()
