"""The published recordings: their entries, fetching by name, and loading with licence and citation."""

import hashlib
import re
from dataclasses import replace
from pathlib import Path

import pytest

from dcgrid_env.traces import TraceError
from dcgrid_env.traces.by_name import recorded_trace
from dcgrid_env.traces.recordings import RECORDINGS, cache_folder, fetch, load_power, load_requests
from helpers.places import SHARED_TRACES, require

FILES = {
    "chen-zhang-2025-inference": SHARED_TRACES / "chen_zhang_2025_gpu_inference.csv",
    "azure-2023-conversation": SHARED_TRACES / "azure_2023_conversation.csv",
    "azure-2023-code": SHARED_TRACES / "azure_2023_code.csv",
}

POWER = b"0,100,200\n0.5,110,210\n2,120,220\n"
LOG = b"TIMESTAMP,ContextTokens,GeneratedTokens\n2023-11-16 18:17:03.97996,4808,10\n2023-11-16 18:17:04.03196,3180,8\n"


def entry(name, content):
    return replace(RECORDINGS[name], sha256=hashlib.sha256(content).hexdigest(), size_bytes=len(content))


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("DCGRID_CACHE", str(tmp_path))
    return tmp_path


def test_entries_are_pinned_and_credited():
    assert set(FILES) < set(RECORDINGS)
    for name, recording in RECORDINGS.items():
        assert recording.name == name
        commit = r"https://raw\.githubusercontent\.com/[^/]+/[^/]+/[0-9a-f]{40}/.+\.(csv|jsonl)"
        release = r"https://github\.com/[^/]+/[^/]+/releases/download/[^/]+/[^/]+\.csv"
        assert re.fullmatch(rf"{commit}|{release}|https://data\.nlr\.gov/system/files/.+\.zip", recording.url)
        assert recording.file_name == f"{name}.{recording.url.rpartition('.')[2]}"
        assert re.fullmatch("[0-9a-f]{64}", recording.sha256)
        assert recording.licence
        assert recording.citation


@pytest.mark.parametrize("name", FILES)
def test_entries_fit_the_files(name):
    content = require(FILES[name]).read_bytes()
    assert entry(name, content) == RECORDINGS[name]
    if RECORDINGS[name].kind == "power":
        trace = load_power(name, FILES[name])
        assert (trace.name, trace.provenance.sha256) == (name, RECORDINGS[name].sha256)
    else:
        requests = load_requests(name, FILES[name])
        assert len(requests) == {"azure-2023-conversation": 19_366, "azure-2023-code": 8_819}[name]


def test_the_cache_folder_is_the_user_s_own_unless_named(monkeypatch, tmp_path):
    monkeypatch.setenv("DCGRID_CACHE", "~/data")
    assert cache_folder() == Path("~/data").expanduser()
    monkeypatch.delenv("DCGRID_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder().name == "dcgrid"


def test_fetch_uses_what_is_in_the_cache(cache, tmp_path):
    recording = entry("chen-zhang-2025-inference", POWER)
    for folder, options in ((cache, {}), (tmp_path / "other", {"cache": tmp_path / "other"})):
        folder.mkdir(exist_ok=True)
        path = folder / "chen-zhang-2025-inference.csv"
        path.write_bytes(POWER)
        assert fetch(recording, **options) == path


def test_power_is_loaded_with_its_credit(cache):
    recording = entry("chen-zhang-2025-inference", POWER)
    (cache / recording.file_name).write_bytes(POWER)
    trace = load_power(recording)
    assert trace.power_kw.tolist() == pytest.approx([0.3, 0.32, 0.34])
    assert trace.provenance.record() == {
        "name": "chen-zhang-2025-inference",
        "sha256": recording.sha256,
        "licence": "MIT",
        "citation": 'Y. Chen and B. Zhang, "Voltage Regulation in Distribution Systems with Data Center Loads", '
        "arXiv 2507.06416",
    }


def test_requests_are_loaded_with_their_credit(cache):
    recording = entry("azure-2023-code", LOG)
    (cache / recording.file_name).write_bytes(LOG)
    requests = load_requests(recording)
    assert requests.context_tokens.tolist() == [4808, 3180]
    assert requests.name == "azure-2023-code"
    assert requests.provenance.sha256 == recording.sha256
    assert requests.provenance.licence == "CC-BY 4.0"
    assert "Splitwise" in requests.provenance.citation


BURST = b"Timestamp,Model,Request tokens,Response tokens,Total tokens,Log Type\n" + b"".join(
    b"%d,GPT-4,400,%d,500,API log\n" % (3600 * hour, 100 * (hour % 7 > 0)) for hour in range(60)
)
MOONCAKE = b"".join(
    b'{"timestamp": %d, "input_length": 6758, "output_length": 500, "hash_ids": [0]}\n' % (3000 * i) for i in range(20)
)


@pytest.mark.parametrize(
    ("name", "content", "n", "duration_s"),
    [("burstgpt", BURST, 21, 86400.0), ("mooncake-conversation", MOONCAKE, 20, 57.0)],
)
def test_other_logs_are_loaded_and_served_by_name(cache, monkeypatch, name, content, n, duration_s):
    recording = entry(name, content)
    monkeypatch.setitem(RECORDINGS, name, recording)
    (cache / recording.file_name).write_bytes(content)
    trace = recorded_trace(name)
    assert trace.duration_s == pytest.approx(duration_s, abs=0.2)
    assert trace.requests is not None
    assert len(trace.requests.arrival_s) == n
    assert trace.provenance.licence == recording.licence
    assert len(load_requests(name, part_s=(0.0, 30.0))) == (1 if name == "burstgpt" else 10)


def test_an_archive_is_unpacked_by_its_user(cache):
    for use in (load_power, load_requests, recorded_trace):
        with pytest.raises(
            TraceError, match=r"'nlr-2026-h100' is an archive; unpack .*nlr-2026-h100\.zip and give one"
        ):
            use("nlr-2026-h100")


@pytest.mark.parametrize("use", [fetch, load_power, load_requests])
def test_an_unknown_name_is_refused(use):
    with pytest.raises(TraceError, match=r"no recording 'azure'; .*`dcgrid list traces` lists all"):
        use("azure")


def test_the_other_kind_is_told_its_loader():
    with pytest.raises(TraceError, match=r"one of requests; use load_requests"):
        load_power("azure-2023-code")
    with pytest.raises(TraceError, match=r"one of power; use load_power"):
        load_requests("chen-zhang-2025-inference")


def test_a_file_that_is_not_there_or_not_it(cache):
    remedy = "get it with `dcgrid traces fetch chen-zhang-2025-inference`"
    with pytest.raises(TraceError, match=rf"there is no file .*inference\.csv; {remedy}"):
        load_power("chen-zhang-2025-inference")
    (cache / "mine.csv").write_bytes(POWER)
    found, known = hashlib.sha256(POWER).hexdigest(), RECORDINGS["chen-zhang-2025-inference"].sha256
    with pytest.raises(TraceError, match=rf"mine\.csv is not it: its SHA-256 is {found}, not {known}; {remedy}"):
        load_power("chen-zhang-2025-inference", cache / "mine.csv")
