"""Record of a fault: kind, channel, samples and treatment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from shipfp_rs.support.arrays import Spans, attributes
from shipfp_rs.support.files import words_of

KINDS: Mapping[str, str] = MappingProxyType(words_of("fault_kinds"))
"""Kinds of faults, with descriptions; A to D3 are in Table 6.10 of the thesis."""
SHOWN = 5
"""Largest number of stretches listed in a message."""


@dataclass(frozen=True)
class Fault:
    """One kind of fault in one channel.

    Parameters
    ----------
    kind
        Key of `KINDS`.
    channel
        Name in the log.
    method
        Treatment.
    spans
        Sample indices [first, stop) of each stretch in the channel, shape (K, 2), ascending.
    excluded
        Whether fits omit these samples: true if they were filled in or are doubtful, false if the fault was only
        reported, or removed without changing the measurement.
    of
        Channel to whose samples the spans refer, if `channel` is a time column.
    """

    kind: str
    channel: str
    method: str
    spans: Spans
    excluded: bool = True
    of: str = ""

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"kind {self.kind!r}, expected one of {', '.join(KINDS)}")
        object.__setattr__(self, "spans", np.asarray(self.spans, dtype=np.int64).reshape(-1, 2))

    def __str__(self) -> str:
        spans = self.spans.tolist()
        shown = ", ".join(f"{start} to {stop - 1}" for start, stop in spans[:SHOWN])
        rest = f" and {len(spans) - SHOWN} more" if len(spans) > SHOWN else ""
        return f"channel {self.channel!r}: {KINDS[self.kind]} at samples {shown}{rest}; {self.method}"

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {
            **attributes(self, "kind", "channel", "method", "excluded"),
            "count": len(self.spans),
            "spans": self.spans.tolist(),
        }
