"""Background work that a page starts and polls, on its own thread."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from shipfp_rs.errors import ShipfpError

T = TypeVar("T")
Progress = Callable[[float], None]


class Background(Generic[T]):
    """Result of a function that may take long and reports the completed fraction, 0 to 1."""

    def __init__(self, function: Callable[[Progress], T]) -> None:
        self._function = function
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self.progress = 0.0
        self.error: str | None = None
        self.result: T | None = None
        self.done = threading.Event()

    def begin(self) -> Background[T]:
        """Start, unless already started."""
        with self._lock:
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, daemon=True)
                self._thread.start()
        return self

    def wait(self) -> T:
        """Wait for the result; `ShipfpError` on failure."""
        self.begin().done.wait()
        if self.result is None:
            raise ShipfpError(self.error or "no result")
        return self.result

    def state(self) -> dict[str, Any]:
        """State for the page: working and progress, failed and reason, or done."""
        if not self.done.is_set():
            return {"state": "working", "progress": round(self.progress, 3)}
        return {"state": "failed", "error": self.error} if self.error is not None else {"state": "done"}

    def _run(self) -> None:
        try:
            self.result = self._function(self._tell)
        except (ShipfpError, OSError, MemoryError) as error:
            self.error = str(error) or type(error).__name__
        except Exception as error:  # every error must reach the waiting page
            self.error = f"internal error: {type(error).__name__}: {error}"
        finally:
            self.done.set()

    def _tell(self, share: float) -> None:
        self.progress = share
