"""The load of the study's data centres: the paper's recording where it is at hand, else the generator for it."""

from __future__ import annotations

from typing import Any, NamedTuple

from dcgrid_env.apps.reproduction.paper import RECORDING
from dcgrid_env.traces import RECORDINGS, TRACE_SOURCES, cache_folder, load_power
from dcgrid_env.traces.by_name import recorded_trace
from dcgrid_env.traces.trace import PowerTrace

GENERATOR = "inference"
"""The generator that replaces the recording."""


class Load(NamedTuple):
    """Where the power of the data centres comes from."""

    kind: str
    """"recorded" or "generated"."""
    description: str
    fields: dict[str, Any]
    """The scenario's fields that select this load."""

    def trace(self) -> PowerTrace:
        """The recording as a whole, or ten minutes of the generator."""
        source = self.fields["trace"]
        return TRACE_SOURCES[source].generate(600.0, 0) if isinstance(source, str) else source[0]


def choose_load(choice: str) -> Load:
    """The load that a user asks for.

    Parameters
    ----------
    choice
        "auto" (the recording if it has been fetched, else the generator), "recorded", "generated", the name of a
        generator or a recording, or a file.

    Raises
    ------
    TraceError
        If a recording or file is missing or unreadable; the message contains the command that fetches it.
    """
    if choice == "auto":
        fetched = cache_folder() / RECORDINGS[RECORDING].file_name
        choice = "recorded" if fetched.is_file() else "generated"
    if choice == "recorded":
        return _recorded(load_power(RECORDING))
    if choice == "generated":
        choice = GENERATOR
    if choice in TRACE_SOURCES:
        return Load("generated", f"generator `{choice}`, test split", {"trace": choice, "split": "test"})
    return _recorded(recorded_trace(choice))


def _recorded(trace: PowerTrace) -> Load:
    # Nothing is learned or tuned here, so no part of the recording has to be kept back. Given out by recording, three
    # of them leave one to the split, and that whole.
    fields = {"trace": (trace,) * 3, "workload.recording_split": "recording", "split": "train"}
    provenance = trace.provenance
    return Load("recorded", f"recording {provenance}, the whole {trace.duration_s:.1f} s", fields)
