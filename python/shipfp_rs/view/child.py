"""Child process that checks or runs a trial for a page; it reports progress in lines and ends with its parent."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import warnings
from pathlib import Path
from typing import Any

GRACE_S = 10.0
"""Time for clean-up after a stop, before the process exits [s]."""


def tell(**message: Any) -> None:
    """Write one message to the parent."""
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


def _end_with_parent() -> None:
    """Stop, as on Ctrl-C, when the parent closes the pipe or dies."""
    sys.stdin.buffer.read()
    os.kill(os.getpid(), signal.SIGINT)
    threading.Event().wait(GRACE_S)
    os._exit(1)


def main(arguments: list[str]) -> int:
    """Run the job given by the arguments: check TRIAL.toml, or run TRIAL.toml FOLDER."""
    from shipfp_rs.errors import ShipfpError
    from shipfp_rs.support.progress import heard_by

    threading.Thread(target=_end_with_parent, daemon=True).start()
    job, path, *rest = arguments
    try:
        with (
            warnings.catch_warnings(),
            heard_by(lambda what, share: tell(progress=what, share=round(share, 4))),
        ):
            warnings.showwarning = lambda message, *_, **__: tell(warning=str(message))
            if job == "check":
                from shipfp_rs.runs.dry_run import check

                tell(done=check(Path(path)).to_dict())
            else:
                from shipfp_rs.runs.run import run
                from shipfp_rs.view.results import doubt_first

                verdict = doubt_first(run(path, rest[0]).fingerprint.verdict)
                tell(done={"folder": Path(rest[0]).name, "verdict": verdict})
    except KeyboardInterrupt:
        tell(stopped=True)
        return 130
    except (ShipfpError, OSError, MemoryError) as error:
        tell(error=" ".join(str(error).split()) or type(error).__name__)
        return 2
    except Exception as error:  # the page shows the error instead of a traceback
        tell(error=f"internal error: {type(error).__name__}: {error}")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
