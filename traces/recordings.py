"""Published recordings: fetched into the user's cache folder, checked, and loaded with their licence and citation.

The package ships none of them. `fetch` is the one function that uses the network.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from dcgrid_env.core.files import sha256_of
from dcgrid_env.core.suggestions import unknown
from dcgrid_env.traces.checks import TraceError
from dcgrid_env.traces.download import Progress, download
from dcgrid_env.traces.logs.request_log import read_request_log
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.serving.requests import Requests
from dcgrid_env.traces.trace import PowerTrace

CACHE_VARIABLE = "DCGRID_CACHE"
"""Environment variable that names the cache folder."""


@dataclass(frozen=True)
class Recording:
    """A published file, pinned by its checksum."""

    name: str
    kind: Literal["power", "requests"]
    url: str
    sha256: str
    """SHA-256 of the file's bytes, hexadecimal."""
    size_bytes: int
    licence: str
    citation: str
    description: str

    @property
    def file_name(self) -> str:
        """Name of the file in the cache folder."""
        return f"{self.name}.csv"


_CHEN_ZHANG = (
    "https://raw.githubusercontent.com/chennnnnyize/voltage-regulation-with-data-centers/"
    "c9e3c78da928bb01cba3b277a7372ab32dd7fe2d"
)
_AZURE = "https://raw.githubusercontent.com/Azure/AzurePublicDataset/790921015d50dd6aae7f7e47f39ba0e235ad6b08/data"
_SPLITWISE = 'P. Patel et al., "Splitwise: Efficient Generative LLM Inference Using Phase Splitting", ISCA 2024'

RECORDINGS: dict[str, Recording] = {
    recording.name: recording
    for recording in (
        Recording(
            "chen-zhang-2025-inference",
            "power",
            f"{_CHEN_ZHANG}/GPU_Inference.csv",
            "c0c15af80a91a73fd23434c571d48a8156fa28119df7bccf4015141d67b52d83",
            102_169,
            "MIT",
            'Y. Chen and B. Zhang, "Voltage Regulation in Distribution Systems with Data Center Loads", '
            "arXiv 2507.06416",
            "power of 8 A100 GPUs over 555 s of Llama 3.1 70B inference, readings 0.1 to 3 s apart",
        ),
        Recording(
            "azure-2023-conversation",
            "requests",
            f"{_AZURE}/AzureLLMInferenceTrace_conv.csv",
            "2f1e5b666d4e3055fdbba98598ce2ec307767b9064e03e2fa46676dbcc7d0bf8",
            719_188,
            "CC-BY 4.0",
            _SPLITWISE,
            "19,366 requests over 1 h of a production chat service",
        ),
        Recording(
            "azure-2023-code",
            "requests",
            f"{_AZURE}/AzureLLMInferenceTrace_code.csv",
            "54e9a6d2a4bd06ba1e060304b900abbc74cbea53de96506e60fe5bb4f2277fb6",
            320_117,
            "CC-BY 4.0",
            _SPLITWISE,
            "8,819 requests over 1 h of a production code-completion service",
        ),
    )
}
"""Published recordings by name."""


def cache_folder() -> Path:
    """Folder of fetched files: $DCGRID_CACHE, or the place for caches of this user on this system."""
    folder = os.environ.get(CACHE_VARIABLE)
    if folder:
        return Path(folder).expanduser()
    import pooch

    return pooch.os_cache("dcgrid")


def fetch(recording: Recording | str, cache: str | Path | None = None, progress: Progress | None = None) -> Path:
    """Return the path of a recording's file, downloaded if it is not in the cache folder yet; see `download`.

    Parameters
    ----------
    recording : one of RECORDINGS, or its name.
    cache : folder, by default `cache_folder()`.
    progress : called with the bytes downloaded and the bytes of the whole file.

    Raises
    ------
    TraceError
        If the name is unknown or the download fails. The message contains the remedy, with the path for a manual
        download. A call after a broken one resumes.
    """
    recording = _recording(recording)
    path = (Path(cache) if cache is not None else cache_folder()) / recording.file_name
    return download(recording.url, recording.sha256, recording.size_bytes, path, progress)


def load_power(recording: Recording | str, path: str | Path | None = None) -> PowerTrace:
    """Load a fetched recording of power, with its checksum, licence and citation as provenance.

    Parameters
    ----------
    recording : one of RECORDINGS of kind "power", or its name.
    path : the file, by default the fetched one in `cache_folder()`; nothing is downloaded.

    Raises
    ------
    TraceError
        For an unknown name, a recording of another kind, or a file that is not there or not the recording.
    """
    recording = _recording(recording, "power")
    trace = PowerTrace.from_csv(_checked(recording, path), name=recording.name)
    return replace(trace, provenance=_credited(trace.provenance, recording))


def load_requests(recording: Recording | str, path: str | Path | None = None) -> Requests:
    """Load a fetched recording of requests; like `load_power`."""
    recording = _recording(recording, "requests")
    requests = read_request_log(_checked(recording, path))
    return replace(requests, name=recording.name, provenance=_credited(requests.provenance, recording))


def _recording(recording: Recording | str, kind: str | None = None) -> Recording:
    if not isinstance(recording, Recording):
        if recording not in RECORDINGS:
            raise TraceError(unknown("recording", recording, RECORDINGS, "`dcgrid list traces` lists all"))
        recording = RECORDINGS[recording]
    if kind not in (None, recording.kind):
        raise TraceError(f"recording {recording.name!r} is one of {recording.kind}; use load_{recording.kind}")
    return recording


def _checked(recording: Recording, path: str | Path | None) -> Path:
    """Path of the file once it is seen to be the recording."""
    path = cache_folder() / recording.file_name if path is None else Path(path)
    remedy = f"get it with `dcgrid traces fetch {recording.name}`"
    if not path.is_file():
        raise TraceError(f"recording {recording.name!r}: there is no file {path}; {remedy}")
    digest = sha256_of(path)
    if digest != recording.sha256:
        raise TraceError(
            f"recording {recording.name!r}: {path} is not it: its SHA-256 is {digest}, not {recording.sha256}; {remedy}"
        )
    return path


def _credited(provenance: Provenance, recording: Recording) -> Provenance:
    return replace(
        provenance,
        name=recording.name,
        sha256=recording.sha256,
        licence=recording.licence,
        citation=recording.citation,
    )
