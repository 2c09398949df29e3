"""Published recordings: fetched into the user's cache folder, checked, and loaded with their licence and citation.

The package ships none of them. `fetch` is the one function that uses the network.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
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
    kind: Literal["power", "requests", "archive"]
    """Content of the file; an archive is unpacked by the user, who then gives one of its files."""
    url: str
    sha256: str
    """SHA-256 of the file's bytes, hexadecimal."""
    size_bytes: int
    licence: str
    citation: str
    description: str
    part_s: tuple[float, float] | None = None
    """Part of a log of requests that a trace by this name serves, s from its first request; None for the whole log."""

    @property
    def file_name(self) -> str:
        """Name of the file in the cache folder, with the suffix of the published file."""
        return self.name + PurePosixPath(self.url).suffix


_CHEN_ZHANG = (
    "https://raw.githubusercontent.com/chennnnnyize/voltage-regulation-with-data-centers/"
    "c9e3c78da928bb01cba3b277a7372ab32dd7fe2d"
)
_AZURE = "https://raw.githubusercontent.com/Azure/AzurePublicDataset/790921015d50dd6aae7f7e47f39ba0e235ad6b08/data"
_AZURE_2024 = "https://github.com/Azure/AzurePublicDataset/releases/download/dataset-llm-2024"
_BURST = "https://github.com/HPMLL/BurstGPT/releases/download/v2.0"
_MOONCAKE = "https://raw.githubusercontent.com/kvcache-ai/Mooncake/3cca71daccf2a7afb8fe3f0295358f70e3a69fdb"
_DYNAMO = (
    'J. Stojkovic et al., "DynamoLLM: Designing LLM Inference Clusters for Performance and Energy Efficiency", '
    "HPCA 2025, arXiv 2408.00741"
)
_FIRST_DAY_S = (0.0, 86400.0)
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
        # The SHA-256 of BurstGPT's file is that of the Git LFS pointer in its repository. The publishers of the four
        # files below it state none: theirs is the one that several independent users of each file have published.
        Recording(
            "burstgpt",
            "requests",
            f"{_BURST}/BurstGPT_without_fails_1.csv",
            "a4d068a7113ec0290e74063a1b3447dc6001a30e4298eb313581b71006dda1f4",
            51_429_517,
            "CC-BY 4.0",
            'Y. Wang et al., "BurstGPT: A Real-world Workload Dataset to Optimize LLM Serving Systems", '
            "arXiv 2401.17644",
            "1.4 million requests over 61 days to ChatGPT and GPT-4 on a campus; the first day as a trace",
            _FIRST_DAY_S,
        ),
        Recording(
            "azure-2024-conversation",
            "requests",
            f"{_AZURE_2024}/AzureLLMInferenceTrace_conv_1week.csv",
            "a0cc9b969a9bbf0fd811802cbf4323edd3a209ace791e3799ad4f9207f213941",
            1_135_195_393,
            "CC-BY 4.0",
            _DYNAMO,
            "27,303,999 requests over a week of production chat services; the first day as a trace",
            _FIRST_DAY_S,
        ),
        Recording(
            "azure-2024-code",
            "requests",
            f"{_AZURE_2024}/AzureLLMInferenceTrace_code_1week.csv",
            "71de5c55cbc35f8f1ed0b6b7806b4cd1e9764b0058469725a6aac98023a1448f",
            691_989_454,
            "CC-BY 4.0",
            _DYNAMO,
            "16,803,695 requests over a week of production code services; the first day as a trace",
            _FIRST_DAY_S,
        ),
        Recording(
            "mooncake-conversation",
            "requests",
            f"{_MOONCAKE}/FAST25-release/traces/conversation_trace.jsonl",
            "b8cbb061a85206d729d91cdc2981f43c9e0d99209dce588d3af5f7934408b9df",
            3_029_533,
            "Apache-2.0",
            'R. Qin et al., "Mooncake: Trading More Storage for Less Computation", FAST 2025',
            "12,031 requests with long contexts over 1 h to the Kimi chat service, times in steps of 3 s",
        ),
        Recording(
            "nlr-2026-h100",
            "archive",
            "https://data.nlr.gov/system/files/312/1775845072-dataset.zip",
            "dcad6de800fb565d850b163902e2eddae48aabd1ed1c7336f9a1cdaf3012f137",
            1_070_866_623,
            "CC-BY 4.0",
            'R. Vercellino et al., "Measurement of Generative AI Workload Power Profiles for Whole-Facility Data '
            'Center Infrastructure Planning", arXiv 2604.07345, data set DOI 10.7799/3025227',
            "zip of WattAMeter logs at 0.1 and 0.2 s from nodes of 4 H100: training, fine-tuning and inference",
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


def load_requests(
    recording: Recording | str, path: str | Path | None = None, part_s: tuple[float, float] | None = None
) -> Requests:
    """Load a fetched recording of requests, or the part of it between two times (`read_request_log`).

    The other parameters and the errors are those of `load_power`.
    """
    recording = _recording(recording, "requests")
    requests = read_request_log(_checked(recording, path), part_s=part_s)
    return replace(requests, name=recording.name, provenance=_credited(requests.provenance, recording))


def _recording(recording: Recording | str, kind: str | None = None) -> Recording:
    if not isinstance(recording, Recording):
        if recording not in RECORDINGS:
            raise TraceError(unknown("recording", recording, RECORDINGS, "`dcgrid list traces` lists all"))
        recording = RECORDINGS[recording]
    if kind not in (None, recording.kind):
        if recording.kind == "archive":
            raise TraceError(
                f"recording {recording.name!r} is an archive; unpack {cache_folder() / recording.file_name} and give "
                "one of its files"
            )
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
