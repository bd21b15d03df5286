"""Run every benchmark: python -m benches, or with --quick on short inputs, just to see that they run."""

import importlib
import pkgutil
import sys
import time

import benches


def main() -> None:
    arguments = sys.argv[1:]
    for module in sorted(info.name for info in pkgutil.iter_modules(benches.__path__)):
        if module.startswith("bench_") or module == "peers":
            print(f"\n{module}", flush=True)
            began = time.perf_counter()
            sys.argv = [module, *arguments]
            importlib.import_module(f"benches.{module}").main()
            print(f"({time.perf_counter() - began:.0f} s)")


if __name__ == "__main__":
    main()
