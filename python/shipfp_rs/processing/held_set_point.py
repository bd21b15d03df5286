"""A set point that the engine holds from sample to sample, and how old it is where the torque is told."""

from __future__ import annotations

from shipfp_rs.logs.channel import Channel
from shipfp_rs.processing.low_pass import SAME_RATE


def age_at(base: Channel, torque: Channel, start_s: float) -> dict[str, float] | None:
    """Return period [s], phase [s] and slip of a held set point: at time t its age is (phase + slip t) modulo period.

    Two clocks of one nominal rate drift past each other, so that this age grows from none to a period and begins anew.
    Where the torque is told at another rate all ages follow one another at once, and the low-pass takes them out: None.

    Parameters
    ----------
    base, torque
        Both channels, their delays removed; the set point's samples lie in the middle of what is held.
    start_s
        Where t is zero, on the log's clock.
    """
    period_s, slip = 1.0 / base.rate_hz, 1.0 - torque.rate_hz / base.rate_hz
    if abs(slip) > SAME_RATE:
        return None
    first_s, frame_s = torque.start_s - start_s, base.start_s - 0.5 * period_s - start_s
    return {"period_s": period_s, "phase_s": (first_s * (1.0 - slip) - frame_s) % period_s, "slip": slip}
