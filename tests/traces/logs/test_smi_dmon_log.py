"""Logs of nvidia-smi dmon in the shapes of its options."""

import numpy as np
import pytest

from dcgrid_env.traces import TraceError, read_smi_dmon_log, recorded_trace
from dcgrid_env.traces.recording_file import file_format

ROWS = [(k, gpu, 100 + 10 * gpu + k) for k in range(4) for gpu in (0, 1)]
HEADER = "#Date       Time        gpu    pwr  gtemp  mtemp\n#YYYYMMDD   HH:MM:SS    Idx      W      C      C\n"
DATED = HEADER + "".join(f" 20260301   12:00:{k:02d}      {g}    {w}     40      -\n" for k, g, w in ROWS)
PLAIN = "# gpu    pwr  gtemp\n# Idx      W      C\n" + "".join(f"    {g}    {w}     40\n" for _, g, w in ROWS)
STAMPED = "".join(f"2026-03-01T12:00:00 {line}\n" for line in PLAIN.splitlines()[:2]) + "".join(
    f"2026-03-01T12:00:{k:02d}.{g:03d}     {g}    {w}     40\n" for k, g, w in ROWS
)
COMMAS = HEADER.replace("    ", ", ") + "".join(f"20260301, 12:00:{k:02d}, {g}, {w}, 40, -\n" for k, g, w in ROWS)


@pytest.mark.parametrize(
    ("text", "options"), [(DATED, {}), (PLAIN, {"step_s": 1.0}), (STAMPED, {}), (COMMAS, {}), (DATED + HEADER, {})]
)
def test_the_gpus_are_summed(tmp_path, text, options):
    path = tmp_path / "dmon.txt"
    path.write_text(text)
    assert file_format(path).name == "smi-dmon"
    trace = read_smi_dmon_log(path, **options)
    np.testing.assert_allclose(trace.time_s, [0.0, 1.0, 2.0, 3.0], atol=1e-6)
    np.testing.assert_allclose(1e3 * trace.power_kw, [210, 212, 214, 216])
    assert trace.began == (None if options else "2026-03-01T12:00:00.000")


def test_a_missing_reading_and_a_last_line_cut_short(tmp_path):
    path = tmp_path / "dmon.txt"
    path.write_text(DATED.replace("111 ", "  - ") + " 20260301   12:00")
    np.testing.assert_allclose(1e3 * recorded_trace(str(path)).power_kw, [210, 211, 214, 216])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (PLAIN, r"dmon.txt, line 3: has no date; log with `nvidia-smi dmon -s p -o DT`, or pass step_s="),
        (DATED.replace("pwr", "sm"), r"line 1: the columns Date, Time, gpu, sm, gtemp, mtemp lack pwr; log with"),
        (DATED.replace(" 101 ", " x "), r"line 5: pwr is 'x', not a number; repair"),
        (DATED.replace("  40      -", "", 1), r"line 3: .* is not a line of `nvidia-smi dmon -s p -o DT` with 6 cells"),
        (DATED + DATED, r"line 13: GPU 0: comes 3 s before that of the reading above"),
    ],
)
def test_errors_name_the_line_and_the_remedy(tmp_path, text, message):
    path = tmp_path / "dmon.txt"
    path.write_text(text)
    with pytest.raises(TraceError, match=message):
        recorded_trace(str(path))
