"""A power trace: irregular samples, each held until the next one, and its exact average on a regular grid."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dcgrid_env.core.files import write_text
from dcgrid_env.traces.checks import FloatArray, TraceError, check_samples, require_positive, steps_in
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.sampling import Sampling, sampling_of
from dcgrid_env.traces.text.csv_file import RECORDED, read_csv
from dcgrid_env.traces.text.text_file import stem
from dcgrid_env.traces.text.times import EPOCH_S, clock_text


class RequestTimes(NamedTuple):
    """Requests behind a trace, or an even sample of them, as they would be served at the top clock.

    Arrays (n,), in the order of arrival.
    """

    arrival_s: FloatArray
    """Time of arrival on the time axis of the trace, s."""
    first_token_s: FloatArray
    """Time from arrival to the first token, s."""
    end_s: FloatArray
    """Time from arrival to the last token, s."""
    prefill_s: FloatArray
    """Part of the time to the first token in which the request is being read, s."""


@dataclass(frozen=True, eq=False, init=False)
class PowerTrace:
    """Power over time; a sample holds until the next, so the last one only marks the end.

    Parameters
    ----------
    time_s : (n,) float64, strictly increasing, s. Need not begin at zero.
    power_kw : (n,) float64, finite, not negative, kW (or a share of rating when the rating is 1 kW).
    name : name of the trace in error messages.
    provenance : origin of the trace: a file with its hash, or a generator with its parameters and seed.
    compute_kw : (n,) float64 in 0 to power_kw, kW, or None if unknown: the part of the power for work whose speed
        follows the clock (prefill, training). The part between it and the idle floor hardly does (decode).
    requests : the requests behind the power as they would be served at the top clock, if it is made of requests.
    rated_kw : rating of the site, kW; if unknown, None, and the highest power is used instead.

    The arrays are copied and made read-only.

    Raises
    ------
    TraceError
        If any of the above is violated; the message contains the trace, the field, the value and the index.
    """

    time_s: FloatArray
    power_kw: FloatArray
    name: str
    provenance: Provenance
    compute_kw: FloatArray | None
    requests: RequestTimes | None
    rated_kw: float | None

    def __init__(
        self,
        time_s: ArrayLike,
        power_kw: ArrayLike,
        name: str = "trace",
        provenance: Provenance | None = None,
        compute_kw: ArrayLike | None = None,
        requests: RequestTimes | None = None,
        rated_kw: float | None = None,
    ) -> None:
        time_s, power_kw = _column(time_s, name, "time_s"), _column(power_kw, name, "power_kw")
        if len(time_s) != len(power_kw):
            raise TraceError(
                f"trace {name!r}: time_s has {len(time_s)} samples, power_kw {len(power_kw)}; "
                "give one power for each time"
            )
        check_samples(time_s, power_kw, lambda i: f"trace {name!r}: index {i}", "time_s", ["power_kw"])
        if compute_kw is not None:
            compute_kw = _column(compute_kw, name, "compute_kw")
            if len(compute_kw) != len(power_kw):
                raise TraceError(
                    f"trace {name!r}: compute_kw has {len(compute_kw)} samples, power_kw {len(power_kw)}; "
                    "give one for each time"
                )
            wrong = np.flatnonzero(~((compute_kw >= 0) & (compute_kw <= power_kw)))
            if wrong.size:
                raise TraceError(
                    f"trace {name!r}: index {wrong[0]}: compute_kw is {compute_kw[wrong[0]]}, not within 0 and the "
                    f"power {power_kw[wrong[0]]:g}; it is the part of the power that follows the clock"
                )
        if rated_kw is not None:
            rated_kw = require_positive(rated_kw, f"trace {name!r}: rated_kw", "give the rating of the site in kW")
        for field, value in (
            ("time_s", time_s),
            ("power_kw", power_kw),
            ("name", name),
            ("provenance", provenance or Provenance()),
            ("compute_kw", compute_kw),
            ("requests", requests),
            ("rated_kw", rated_kw),
        ):
            object.__setattr__(self, field, value)

    @classmethod
    def from_csv(
        cls,
        path: str | Path,
        *,
        time_column: int | str | None = None,
        power_columns: Sequence[int | str] | None = None,
        unit: str | None = None,
        header: bool | None = None,
        delimiter: str | None = None,
        max_gap_s: float | None = None,
        gaps: str = "error",
        limit_kw: float | None = None,
        invalid: str = "error",
        name: str | None = None,
    ) -> "PowerTrace":
        """Read a trace from a text file; see `dcgrid_env.traces.text.csv_file.read_csv`."""
        time_s, power_kw, rated_kw, provenance = read_csv(
            path,
            time_column,
            power_columns,
            unit,
            header,
            delimiter,
            max_gap_s=max_gap_s,
            gaps=gaps,
            limit_kw=limit_kw,
            invalid=invalid,
        )
        return cls(time_s, power_kw, name=name or stem(path), provenance=provenance, rated_kw=rated_kw)

    def to_csv(self, path: str | Path) -> None:
        """Write the trace to a CSV file, which `from_csv` reads back exactly, with its rating and origin.

        Power of a trace in shares of a rating of 1 kW is written as `site_share`, other power as `site_kw`. The file is
        written whole or not at all.
        """
        is_noted = not self.is_share and self.rated_kw is not None
        notes = {"source": self.provenance.record()} | ({"rated_kw": self.rated_kw} if is_noted else {})
        rows = "".join(f"{t!r},{p!r}\n" for t, p in zip(self.time_s.tolist(), self.power_kw.tolist(), strict=True))
        header = f"time_s,{'site_share' if self.is_share else 'site_kw'}\n"
        write_text(Path(path), f"{RECORDED}{json.dumps(notes)}\n{header}{rows}")

    @property
    def asked_by(self) -> str | None:
        """Name or file that `recorded_trace` made it of; None for a trace made otherwise."""
        return self.__dict__.get("_asked_by")

    @property
    def began(self) -> str | None:
        """Date and time of the first sample, ISO 8601; None if it is unknown.

        It is in UTC if the file has UTC offsets or times since 1970, and on the recording's own clock otherwise.
        """
        noted = self.provenance.parameters
        if "began" not in noted:  # a file that `to_csv` wrote
            noted = noted.get("source", {}).get("parameters", {})
        since_1970 = EPOCH_S[0] <= self.time_s[0] < EPOCH_S[1]
        return noted.get("began") or (clock_text(float(self.time_s[0])) if since_1970 else None)

    @property
    def sampling(self) -> Sampling:
        """Sampling of the meters that were summed; that of `time_s` if they are not known."""
        return self.__dict__.get("_sampling") or sampling_of({self.name: self.time_s})

    @property
    def is_share(self) -> bool:
        """Whether the power is a share of a rating, which is then 1 kW."""
        return self.rated_kw == 1.0

    @property
    def duration_s(self) -> float:
        """Time from the first sample to the last, s."""
        return float(self.time_s[-1] - self.time_s[0])

    @property
    def energy_kws(self) -> float:
        """Integral of the held power over the whole duration, kW s."""
        return float(np.sum(self.power_kw[:-1] * np.diff(self.time_s)))

    def require_duration(self, needed_s: float) -> "PowerTrace":
        """Return the trace itself; raise TraceError if it is shorter than `needed_s`."""
        needed_s = require_positive(needed_s, "needed_s", "give a duration in seconds")
        if steps_in(self.duration_s, needed_s) < 1:
            raise TraceError(
                f"trace {self.name!r} lasts {self.duration_s:g} s but {needed_s:g} s are needed; "
                "give a longer trace or a shorter episode"
            )
        return self

    def scaled_to(self, rating_kw: float) -> "PowerTrace":
        """Return the trace multiplied so that its highest power is exactly `rating_kw`.

        Raises
        ------
        TraceError
            If the rating is not above zero, or the trace is zero throughout.
        """
        rating_kw = require_positive(rating_kw, "rating_kw", "give the rating of the site in kW")
        peak_kw = float(self.power_kw.max())
        if peak_kw == 0.0:
            raise TraceError(
                f"trace {self.name!r}: power_kw is 0 in all {len(self.power_kw)} samples and cannot be scaled to "
                f"{rating_kw:g} kW; check the power columns"
            )
        # Divided first, so that the peak is exactly the rating.
        power_kw, compute_kw = self.power_kw / peak_kw * rating_kw, self.compute_kw
        if compute_kw is not None:
            compute_kw = compute_kw / peak_kw * rating_kw
        return self._changed(power_kw=power_kw, compute_kw=compute_kw, rated_kw=rating_kw)

    def rated_at(self, rating_kw: float) -> "PowerTrace":
        """Return the trace with another rating and the same power."""
        return self._changed(rated_kw=rating_kw)

    def with_site_rating(self, rating_kw: float) -> "PowerTrace":
        """Return the trace of a site of this rating: its shares times the rating, or its power in kW unchanged.

        Raises TraceError if the rating is not above zero.
        """
        rating_kw = require_positive(rating_kw, "rating_kw", "give the rating of the site in kW")
        if not self.is_share:
            return self.rated_at(rating_kw)
        compute_kw = None if self.compute_kw is None else self.compute_kw * rating_kw
        return self._changed(power_kw=self.power_kw * rating_kw, compute_kw=compute_kw, rated_kw=rating_kw)

    def as_share(self) -> "PowerTrace":
        """Return the trace as a share of its rating, or of its highest power if the rating is unknown."""
        if self.rated_kw is None:
            return self.scaled_to(1.0)
        compute_kw = None if self.compute_kw is None else self.compute_kw / self.rated_kw
        return self._changed(power_kw=self.power_kw / self.rated_kw, compute_kw=compute_kw, rated_kw=1.0)

    def resample(self, dt_s: float) -> FloatArray:
        """Average the power over each [k dt, (k + 1) dt) from the first sample on.

        The means are differences of the cumulative integral, so their sum times `dt_s` is the energy of the whole
        steps covered. The rest after the last whole step is dropped.

        Returns
        -------
        (n_steps,) float64, kW, n_steps = floor(duration_s / dt_s)

        Raises
        ------
        TraceError
            If `dt_s` is not above zero, or the trace is shorter than one step.
        """
        return self._means(self.power_kw, dt_s)

    def resample_compute(self, dt_s: float) -> FloatArray | None:
        """Mean of `compute_kw` over the steps of `resample`, (n_steps,) float64, kW; None where it is not known."""
        return None if self.compute_kw is None else self._means(self.compute_kw, dt_s)

    def _changed(self, **fields: Any) -> "PowerTrace":
        """Return the trace with other fields, and the same sampling."""
        changed = replace(self, **fields)
        if "_sampling" in self.__dict__:
            changed.__dict__["_sampling"] = self.__dict__["_sampling"]
        return changed

    def _means(self, values: FloatArray, dt_s: float) -> FloatArray:
        dt_s = require_positive(dt_s, "dt_s", "give a step in seconds")
        self.require_duration(dt_s)
        time_s = self.time_s - self.time_s[0]
        edge_s = _snapped(dt_s * np.arange(steps_in(self.duration_s, dt_s) + 1, dtype=np.float64), time_s, 1e-9 * dt_s)
        energy = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(time_s))])
        mean_kw = np.diff(np.interp(edge_s, time_s, energy)) / dt_s
        # A mean lies between the samples it is made of; cancellation in the difference may put it 1e-12 outside.
        first = np.searchsorted(time_s, edge_s[:-1], side="right") - 1
        last = np.searchsorted(time_s, edge_s[1:], side="left").clip(max=len(time_s) - 1)
        pairs = np.column_stack([first, last]).ravel()
        lowest_kw = np.minimum.reduceat(values, pairs)[::2]
        highest_kw = np.maximum.reduceat(values, pairs)[::2]
        return np.clip(mean_kw, lowest_kw, highest_kw)


def _column(values: ArrayLike, name: str, field: str) -> FloatArray:
    """Copy to a read-only float64 vector of at least two samples."""
    try:
        column = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise TraceError(f"trace {name!r}: {field} is not a list of numbers ({error})") from error
    if column.ndim != 1 or len(column) < 2:
        raise TraceError(
            f"trace {name!r}: {field} has shape {column.shape}; give at least 2 samples in one dimension "
            "(a sample holds until the next)"
        )
    column.setflags(write=False)
    return column


def _snapped(edge_s: FloatArray, time_s: FloatArray, tolerance_s: float) -> FloatArray:
    """Move edges that differ from a sample time by rounding alone onto that time, so that no sliver is mixed in."""
    right = np.searchsorted(time_s, edge_s).clip(1, len(time_s) - 1)
    nearest = np.where(edge_s - time_s[right - 1] < time_s[right] - edge_s, time_s[right - 1], time_s[right])
    return np.where(np.abs(edge_s - nearest) <= tolerance_s, nearest, edge_s)
