"""Running median and decimating low-pass against SciPy's, on a torque signal of 2 kHz.

Build with `maturin develop --release`, then `python -m benches.bench_filter`. All figures come from one run.
"""

import numpy as np
from scipy import signal
from scipy.ndimage import median_filter

from benches.timing import asked, median_time, print_table
from shipfp_rs._core import Decimator, running_median


def main() -> None:
    quick = {"samples": 50_000, "repeats": 1}
    options = asked(__doc__, quick, samples=1_000_000, repeats=5)
    rng = np.random.default_rng(1)
    torque = (
        1725.0 + 60.0 * np.sin(np.arange(options.samples) * 0.186) + rng.normal(0.0, 21.0, options.samples)
    )
    taps = signal.firwin(1005, 1.0 / 40.0)
    outputs = len(torque) // 40

    def decimated() -> np.ndarray:
        filter_ = Decimator(taps, 1, 40)
        return np.concatenate([filter_.feed(torque), filter_.finish(outputs)])[:outputs]

    cases = {
        f"running median of {window}": (
            lambda window=window: running_median(torque, window),
            lambda window=window: median_filter(torque, window),
        )
        for window in (201, 2001)
    }
    cases["low-pass of 1005 taps, 2000 to 50 Hz"] = (
        decimated,
        lambda: signal.resample_poly(torque, 1, 40, window=taps, padtype="edge")[:outputs],
    )
    rows = []
    for name, (ours, theirs) in cases.items():
        np.testing.assert_allclose(ours(), theirs(), rtol=1e-12)
        times = [median_time(call, options.repeats) / len(torque) * 1e9 for call in (ours, theirs)]
        rows.append([name, *(f"{time:.1f}" for time in times), f"{times[1] / times[0]:.1f}"])
    print_table(["ns a sample", "ours", "SciPy", "times ours"], rows)


if __name__ == "__main__":
    main()
