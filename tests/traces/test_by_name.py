"""A trace by name, or by what is in a file."""

import numpy as np
import pytest

from dcgrid_env.traces import TraceError
from dcgrid_env.traces.by_name import recorded_trace

LOG = "timestamp, index, power.draw [W]\n" + "".join(
    f"2026/01/02 03:04:{s:02d}.000, 0, {100 + s}.00 W\n" for s in range(30)
)
REQUESTS = "TIMESTAMP,ContextTokens,GeneratedTokens\n" + "".join(
    f"2023-11-16 18:17:{s:02d}.9799600,4808,100\n" for s in range(50)
)


@pytest.mark.parametrize(
    ("content", "duration_s", "lowest_kw"),
    [
        ("0,100,200\n10,110,210\n", 10.0, 0.3),
        ("# by hand, 2026/01/02\n\ntime_s,a/b [W],c/d [W]\n0,100,200\n10,110,210\n", 10.0, 0.3),
        ('# dcgrid trace {"gpus": "a/b/c", "unit": "power.draw"}\ntime_s,gpu0_w\n0,100\n10,110\n', 10.0, 0.1),
        (LOG, 29.0, 0.1),
        ("# node 7: 0,1\n# time,power\n\n" + LOG, 29.0, 0.1),
        ("# node 7\n" + LOG.partition("\n")[2].replace(", 0,", ", 00000000:3B:00.0,"), 29.0, 0.1),
        (LOG.partition("\n")[2].replace("/", "-").replace(", 0,", ","), 29.0, 0.1),
        (REQUESTS, 49.1, 0.4),
        ("# Azure\n" + REQUESTS, 49.1, 0.4),
    ],
)
def test_a_file_is_read_as_what_it_is(tmp_path, content, duration_s, lowest_kw):
    path = tmp_path / "recorded.csv"
    path.write_text(content, encoding="utf-8")
    trace = recorded_trace(str(path))
    assert trace.duration_s == pytest.approx(duration_s)
    assert trace.power_kw.min() == pytest.approx(lowest_kw, rel=0.1)
    assert len(trace.provenance.sha256) == 64
    assert (trace.requests is not None) == ("ContextTokens" in content)


def test_requests_are_served_by_a_site_of_their_load(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(REQUESTS, encoding="utf-8")
    times = recorded_trace(str(path)).requests
    assert times is not None
    assert len(times.arrival_s) == 50
    assert np.isfinite(times.end_s).all()


def test_what_is_neither_known_nor_a_file_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("DCGRID_CACHE", str(tmp_path))
    with pytest.raises(TraceError, match="no trace 'nothing'; `dcgrid list traces` lists all; or give a file"):
        recorded_trace("nothing")
    with pytest.raises(TraceError, match="get it with `dcgrid traces fetch azure-2023-code`"):
        recorded_trace("azure-2023-code")
