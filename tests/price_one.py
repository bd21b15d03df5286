"""One frozen draw in a process of its own; see `tests.price`."""

from __future__ import annotations

import json
import pickle
import sys
import warnings
from pathlib import Path

from tests.families.one import identified

if __name__ == "__main__":
    warnings.simplefilter("ignore")
    experiment, _ = pickle.loads(Path(sys.argv[1]).read_bytes())
    result = identified(experiment, None)
    Path(sys.argv[2]).write_text(json.dumps(result), encoding="utf-8")
