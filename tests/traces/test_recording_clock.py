"""The date and time of a recording's first sample, from each kind of file that states one."""

import json
from datetime import UTC, datetime

import numpy as np
import pytest

from dcgrid_env.traces import PowerTrace, Provenance, recorded_trace
from dcgrid_env.traces.recording_clock import Clock, clock_of

AT = datetime(2026, 3, 1, 11, 30, tzinfo=UTC).timestamp()
"""11:30 UTC, 12:30 at +01:00."""
SMI = "timestamp, index, power.draw [W]\n" + "".join(f"2026/03/01 11:30:{s:02d}.000, 0, 300.00 W\n" for s in range(3))
PROMETHEUS = json.dumps(
    {
        "data": {
            "resultType": "matrix",
            "result": [
                {"metric": {"__name__": "DCGM_FI_DEV_POWER_USAGE", "UUID": "a"}, "values": [[AT, "1"], [AT + 1, "2"]]}
            ],
        }
    }
)


@pytest.mark.parametrize(
    ("name", "text", "offset_h"),
    [
        ("smi.csv", SMI, None),
        ("local.csv", "time,site_kw\n2026-03-01T11:30:00,1\n2026-03-01T11:30:01,2\n", None),
        ("utc.csv", "time,site_kw\n2026-03-01T11:30:00Z,1\n2026-03-01T11:30:01Z,2\n", 0.0),
        ("zone.csv", "time,site_kw\n2026-03-01T12:30:00+01:00,1\n2026-03-01T12:30:01+01:00,2\n", 1.0),
        ("epoch.csv", f"time_s,site_kw\n{AT},1\n{AT + 1},2\n", 0.0),
        (
            "recorder.csv",
            '# dcgrid trace {"started": "2026-03-01T11:30:00.000+00:00"}\ntime_s,gpu0_w\n0,1\n1,2\n',
            0.0,
        ),
        ("prometheus.json", PROMETHEUS, 0.0),
    ],
)
def test_each_dated_file_has_its_clock_also_after_it_was_saved(tmp_path, name, text, offset_h):
    (tmp_path / name).write_text(text)
    trace = recorded_trace(str(tmp_path / name))
    trace.to_csv(tmp_path / "saved.csv")
    for read in (trace, recorded_trace(str(tmp_path / "saved.csv")), trace.rated_at(10.0)):
        clock = clock_of(read)
        assert clock is not None
        assert clock == (AT, offset_h)


@pytest.mark.parametrize(("first_s", "parameters"), [(0.0, {}), (4096.0, {}), (0.0, {"began": "soon"})])
def test_a_file_without_dates_has_none(first_s, parameters):
    assert clock_of(PowerTrace([first_s, first_s + 1.0], [1.0, 1.0], "x", Provenance("x", None, parameters))) is None


@pytest.mark.parametrize(
    ("offset_h", "place_h", "wanted_h"), [(None, 2.0, 11.5), (0.0, None, 11.5), (1.0, None, 12.5), (1.0, 2.0, 13.5)]
)
def test_clocks_with_offsets_agree_and_others_are_taken_as_local(offset_h, place_h, wanted_h):
    found = Clock(AT, offset_h).local_s(place_h)
    assert np.isclose(found % 86400.0 / 3600.0, wanted_h)
