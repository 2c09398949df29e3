"""Requests to a language model: arrival times, context tokens and generated tokens."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dcgrid_env.traces.checks import FloatArray, TraceError
from dcgrid_env.traces.provenance import Provenance

IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Requests:
    """Requests in the order of arrival; all arrays are copied and made read-only.

    Raises TraceError, naming the field and the index, for lengths that differ and for times that are not finite,
    negative or not sorted. Token counts that are not whole numbers of at least 1 also raise it. Equal times are
    allowed, as requests may arrive together.
    """

    arrival_s: FloatArray
    """s from the beginning, (n,) float64."""
    context_tokens: IntArray
    """Tokens that a request brings, (n,) int64."""
    generated_tokens: IntArray
    """Tokens that it gets back, (n,) int64."""
    duration_s: float
    """Length of the time in which they arrived, s; at least the last arrival."""
    name: str = "requests"
    provenance: Provenance = field(default_factory=Provenance)

    def __post_init__(self) -> None:
        arrival_s = np.array(self.arrival_s, dtype=np.float64)
        for name, values in (
            ("arrival_s", arrival_s),
            ("context_tokens", _tokens(self.name, "context_tokens", self.context_tokens)),
            ("generated_tokens", _tokens(self.name, "generated_tokens", self.generated_tokens)),
        ):
            if values.shape != arrival_s.shape or values.ndim != 1:
                raise TraceError(
                    f"requests {self.name!r}: {name} has shape {values.shape}, arrival_s {arrival_s.shape}; "
                    "give one number for each request"
                )
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        wrong = np.flatnonzero(~(np.isfinite(arrival_s) & (arrival_s >= 0)))
        if wrong.size:
            raise TraceError(
                f"requests {self.name!r}: index {wrong[0]}: arrival_s is {arrival_s[wrong[0]]}; give times from 0 on"
            )
        wrong = np.flatnonzero(np.diff(arrival_s) < 0)
        if wrong.size:
            i = int(wrong[0]) + 1
            raise TraceError(
                f"requests {self.name!r}: index {i}: arrival_s {arrival_s[i]} comes after {arrival_s[i - 1]}; "
                "sort the requests by arrival"
            )
        if not (np.isfinite(self.duration_s) and self.duration_s > 0 and self.duration_s >= arrival_s.max(initial=0.0)):
            raise TraceError(
                f"requests {self.name!r}: duration_s = {self.duration_s!r} does not cover the arrivals; give at least "
                f"{arrival_s.max(initial=0.0):g}"
            )

    def __len__(self) -> int:
        return len(self.arrival_s)


def _tokens(name: str, field_name: str, values: ArrayLike | Any) -> IntArray:
    counts = np.asarray(values)
    wrong = np.flatnonzero(~(np.isfinite(counts) & (counts >= 1) & (counts == np.floor(counts))))
    if wrong.size:
        count = counts.flat[wrong[0]]
        raise TraceError(
            f"requests {name!r}: index {wrong[0]}: {field_name} is {count}; give whole numbers of at least 1"
        )
    return counts.astype(np.int64)
