"""Samples further apart than a limit: an error, or filled by choice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dcgrid_env.traces.checks import FloatArray, TraceError, require_positive

GAP_RULES = ("error", "hold", "linear")
USUAL_DISTANCES = 5.0
LEAST_GAP_S = 15.0
"""By default, readings of a meter have a gap between them if they are further apart than LEAST_GAP_S and than
USUAL_DISTANCES times their usual distance."""
FILL_LIMIT = 1_000_000
"""Samples that may be put into one gap; more mean a wrong clock rather than a gap."""


def meter_rule(max_gap_s: float | None, gaps: str, distance_s: FloatArray) -> GapRule:
    """Return the rule for readings of a meter `distance_s` apart; None for `max_gap_s` is the default limit."""
    usual_s = float(np.median(distance_s)) if len(distance_s) else 0.0
    return GapRule(max(LEAST_GAP_S, USUAL_DISTANCES * usual_s) if max_gap_s is None else max_gap_s, gaps)


@dataclass(frozen=True)
class GapRule:
    """Rule for two samples that are more than `max_gap_s` apart.

    "error" refuses the file. "hold" keeps the earlier sample until the later one. "linear" adds samples on the straight
    line between the two, evenly and at most `max_gap_s` apart, each applied like a recorded one.

    Raises TraceError for an unknown rule, a limit that is not above 0, and "linear" without a limit.
    """

    max_gap_s: float | None
    """s; None accepts every distance."""
    gaps: str

    def __post_init__(self) -> None:
        if self.gaps not in GAP_RULES:
            raise TraceError(f"gaps = {self.gaps!r} is unknown; choose one of {', '.join(GAP_RULES)}")
        if self.max_gap_s is not None:
            require_positive(self.max_gap_s, "max_gap_s", "give the longest distance between samples in s, or None")
        elif self.gaps == "linear":
            raise TraceError("gaps = 'linear' needs max_gap_s: the distance in s above which samples are put in")

    def refuses(self, distance_s: float) -> bool:
        """Whether a distance is an error."""
        return self.gaps == "error" and self.max_gap_s is not None and distance_s > self.max_gap_s

    def apply(
        self, time_s: FloatArray, power_kw: FloatArray, where: Callable[[int], str]
    ) -> tuple[FloatArray, FloatArray]:
        """Samples with their gaps treated.

        Parameters
        ----------
        time_s, power_kw : (n,) float64, times increasing.
        where : index of a sample -> text that begins the message, for example "file.csv, line 7".

        Returns
        -------
        time_s, power_kw : (m,) float64 each, m >= n

        Raises
        ------
        TraceError
            For a gap if the rule is "error", and for one that would take more than FILL_LIMIT samples.
        """
        if self.max_gap_s is None or self.gaps == "hold" or len(time_s) < 2:
            return time_s, power_kw
        distance_s = np.diff(time_s)
        wide = np.flatnonzero(distance_s > self.max_gap_s)
        if not wide.size:
            return time_s, power_kw
        if self.gaps == "error":
            raise TraceError(
                f"{where(int(wide[0]) + 1)}: comes {distance_s[wide[0]]:g} s after the sample before, more than "
                f"max_gap_s = {self.max_gap_s:g}; raise max_gap_s, cut the file there, or pass gaps='hold' or 'linear'"
            )
        longest = int(np.argmax(distance_s))
        if distance_s[longest] / self.max_gap_s > FILL_LIMIT:
            raise TraceError(
                f"{where(longest + 1)}: comes {distance_s[longest]:g} s after the sample before, which would take "
                f"more than {FILL_LIMIT} samples every {self.max_gap_s:g} s; check the clock, raise max_gap_s, "
                "cut the file there, or pass gaps='hold'"
            )
        return _on_lines(time_s, power_kw, distance_s, self.max_gap_s)


def _on_lines(time_s: FloatArray, power_kw: FloatArray, distance_s: FloatArray, max_gap_s: float):
    """Samples of the straight lines between the given ones, with the given ones among them unchanged."""
    pieces = np.maximum(np.ceil(distance_s / max_gap_s), 1).astype(np.int64)
    before = np.repeat(np.arange(len(distance_s)), pieces)
    share = (np.arange(len(before)) - np.repeat(np.cumsum(pieces) - pieces, pieces)) / pieces[before]
    return (
        np.append(time_s[before] + share * distance_s[before], time_s[-1]),
        np.append(power_kw[before] + share * np.diff(power_kw)[before], power_kw[-1]),
    )
