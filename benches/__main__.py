"""Run every benchmark: python -m benches, or with --quick on short inputs, just to see that they run."""

import importlib
import pkgutil
import sys

import benches


def main() -> None:
    arguments = sys.argv[1:]
    for module in sorted(info.name for info in pkgutil.iter_modules(benches.__path__)):
        if module.startswith("bench_") or module == "peers":
            print(f"\n{module}")
            sys.argv = [module, *arguments]
            importlib.import_module(f"benches.{module}").main()


if __name__ == "__main__":
    main()
