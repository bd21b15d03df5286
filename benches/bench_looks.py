"""How much each kernel goes on to compute after a signal: `python -m benches.bench_looks`, with a release build installed.

Every kernel is given much to do and stopped at times by chance. Processor time from the moment at which it is asked to
stop to its end, the longest of all: it does not matter what else the machine does.
"""

import argparse
import subprocess
import sys

from tests.kernels.long_kernels import KERNELS

from benches.timing import print_table


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stops", type=int, default=20, help="of each kernel")
    parser.add_argument(
        "--quick", action="store_true", help="two stops of three kernels, just to see that it runs"
    )
    options = parser.parse_args()
    rows = []
    kernels = [kernel for kernel in KERNELS if kernel != "spin"]  # which sleeps
    for kernel in kernels[:3] if options.quick else kernels:
        done = subprocess.run(
            [
                sys.executable,
                "-m",
                "tests.kernels.long_kernels",
                kernel,
                f"{2 if options.quick else options.stops}",
            ],
            capture_output=True,
            text=True,
            check=True,
        )
        rows.append((float(done.stdout.split()[-1]), kernel))
        print(f"{kernel}: {1e3 * rows[-1][0]:.1f} ms", flush=True)
    print_table(
        ["kernel", "ms to its end"],
        [[kernel, f"{1e3 * longest:.1f}"] for longest, kernel in sorted(rows, reverse=True)],
    )


if __name__ == "__main__":
    main()
