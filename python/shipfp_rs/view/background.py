"""Work that a page asks for and then looks at from time to time: begun once, on a thread of its own."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from shipfp_rs.errors import ShipfpError

T = TypeVar("T")
Progress = Callable[[float], None]


class Background(Generic[T]):
    """The result of a function that may take long.

    Parameters
    ----------
    function
        Given a function that takes the share done, 0 to 1.
    """

    def __init__(self, function: Callable[[Progress], T]) -> None:
        self._function = function
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self.progress = 0.0
        self.error: str | None = None
        self.result: T | None = None
        self.done = threading.Event()

    def begin(self) -> Background[T]:
        """Begin, unless it has begun."""
        with self._lock:
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, daemon=True)
                self._thread.start()
        return self

    def wait(self) -> T:
        """Return the result when there is one; `ShipfpError` where there will be none."""
        self.begin().done.wait()
        if self.result is None:
            raise ShipfpError(self.error or "no result")
        return self.result

    def state(self) -> dict[str, Any]:
        """Return what a page is told: working and how far, failed and why, or done."""
        if not self.done.is_set():
            return {"state": "working", "progress": round(self.progress, 3)}
        return {"state": "failed", "error": self.error} if self.error is not None else {"state": "done"}

    def _run(self) -> None:
        try:
            self.result = self._function(self._tell)
        except (ShipfpError, OSError, MemoryError) as error:
            self.error = str(error) or type(error).__name__
        except Exception as error:  # whatever it was, the waiting page must show an error
            self.error = f"internal error: {type(error).__name__}: {error}"
        finally:
            self.done.set()

    def _tell(self, share: float) -> None:
        self.progress = share
