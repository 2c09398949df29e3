"""Logs of nvidia-smi in the shapes they are found in, and the errors that name the line."""

import gzip
import hashlib
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcgrid_env.traces import TraceError
from dcgrid_env.traces.logs import meters
from dcgrid_env.traces.logs.gpu_log import read_gpu_log
from dcgrid_env.traces.text import text_file


@pytest.fixture
def write(tmp_path):
    def write_text(text, name="gpu.log"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8", newline="")
        return path

    return write_text


def rows(*readings, day="2023/11/16 18:17:"):
    """Lines of a log from (second, cells after the time)."""
    return "".join(f"{day}{second:06.3f}, {cells}\n" for second, cells in readings)


ONE = "timestamp, power.draw [W]\n"
ONE_ROWS = rows((3.979, "70.25 W"), (4.979, "300.50 W"), (5.98, "71.00 W"))
TWO = "timestamp, index, power.draw [W]\n"
TWO_ROWS = rows((1, "0, 70 W"), (1.004, "1, 80 W"), (2, "0, 170 W"), (2.004, "1, 180 W"))


def test_one_gpu(write):
    path = write(ONE + ONE_ROWS)
    trace = read_gpu_log(path)
    np.testing.assert_allclose(trace.time_s, [0.0, 1.0, 2.001], atol=1e-12)
    np.testing.assert_allclose(trace.power_kw, [0.07025, 0.3005, 0.071])
    assert (trace.name, trace.provenance.name) == ("gpu", "gpu.log")
    assert trace.provenance.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert trace.provenance.parameters == {"began": "2023-11-16T18:17:03.979", "gpus": 1, "column": "power.draw"}
    assert read_gpu_log(path, name="rack").name == "rack"


UUID = "GPU-09cb2925-9d01-5ca4-810b-6cdebe86b71a"


@pytest.mark.parametrize(
    ("text", "options"),
    [
        # Header and cells: without units, names without a unit, other columns around, the other power columns.
        (ONE + ONE_ROWS.replace(" W", ""), {}),
        ("timestamp, power.draw\n" + ONE_ROWS, {}),
        ("timestamp, power.draw\n" + ONE_ROWS.replace(" W", ""), {"unit": "W"}),
        ("timestamp, power.draw.average [W]\n" + ONE_ROWS, {}),
        ("timestamp, power.draw.instant [W], power.draw [W]\n" + ONE_ROWS.replace(" W", " W, 9.00 W"), {}),
        (
            "timestamp, name, clocks.current.sm [MHz], power.draw [W], power.limit [W], pstate\n"
            + ONE_ROWS.replace(", ", ", NVIDIA A100-SXM4-80GB, 1410 MHz, ").replace(" W", " W, 400.00 W, P0"),
            {},
        ),
        # Without a header: told from the cells, or by the caller.
        (ONE_ROWS, {}),
        (ONE_ROWS.replace(" W", " W, 45, [N/A]"), {}),
        (ONE_ROWS.replace(", ", f", {UUID}, "), {}),
        (ONE_ROWS.replace(", ", ", 00000000:3B:00.0, "), {}),
        (ONE_ROWS.replace(" W", ""), {"unit": "W"}),
        (ONE_ROWS.replace(" W", ""), {"columns": "timestamp, power.draw [W]"}),
        (ONE_ROWS.replace(", ", ", 0, "), {"columns": ["timestamp", "index", "power.draw"]}),
        (rows((0.5, "[N/A]")) + ONE_ROWS, {}),
        # Ends of lines, a byte order mark, blank lines, a note, a header in the middle, a last line cut short.
        ((ONE + ONE_ROWS).replace("\n", "\r\n"), {}),
        ("\ufeff" + ONE + ONE_ROWS, {}),
        ("# node 7\n\n" + ONE + ONE_ROWS + "\n\n", {}),
        (ONE + ONE_ROWS.replace("\n", "\n" + ONE), {}),
        (ONE + ONE_ROWS + "2023/11/16 18:1", {}),
        (ONE + ONE_ROWS + "2023/11/16 18:17:07.123, ", {}),
        ((ONE + ONE_ROWS).rstrip("\n"), {}),
        (TWO + ONE_ROWS.replace(", ", ", 0, ") + "2023/11/16 18:17:07.123, 1", {}),
        (
            "timestamp, power.draw [W], uuid\n"
            + ONE_ROWS.replace(" W", f" W, {UUID}")
            + "2023/11/16 18:17:07, 7 W, GPU",
            {},
        ),
    ],
)
def test_shapes_of_the_same_log(write, text, options):
    trace = read_gpu_log(write(text), **options)
    np.testing.assert_allclose(trace.time_s, [0.0, 1.0, 2.001], atol=1e-12)
    np.testing.assert_allclose(trace.power_kw, [0.07025, 0.3005, 0.071])


def test_utf16_and_gzip(tmp_path):
    path = tmp_path / "gpu.csv.gz"
    path.write_bytes(gzip.compress((ONE + ONE_ROWS).encode("utf-16")))
    trace = read_gpu_log(path)
    assert (trace.name, len(trace.time_s)) == ("gpu", 3)


def test_units_of_cells_and_header(write):
    text = "timestamp, power.draw [mW]\n" + rows((1, "70000"), (2, "80000 mW"))
    np.testing.assert_allclose(read_gpu_log(write(text)).power_kw, [0.07, 0.08])


def test_several_gpus_are_summed_from_when_all_have_reported(write):
    for head, told in ((TWO, ""), ("timestamp, uuid, power.draw [W]\n", "GPU-")):
        trace = read_gpu_log(write(head + TWO_ROWS.replace(", 0,", f", {told}0,").replace(", 1,", f", {told}1,")))
        np.testing.assert_allclose(trace.time_s, [0.0, 1.0], atol=1e-12)
        np.testing.assert_allclose(trace.power_kw, [0.15, 0.35])
        assert trace.provenance.parameters["gpus"] == 2
        assert trace.began == "2023-11-16T18:17:01.000"


def test_rounds_in_order_when_their_number_is_told(write):
    lines = TWO_ROWS.replace(" 0,", "").replace(" 1,", "")
    trace = read_gpu_log(write(ONE + lines), gpus=2)
    np.testing.assert_allclose(trace.power_kw, [0.15, 0.35])
    # Times of a round may be equal, and a header begins a new round.
    lines = rows((1, "70 W"), (1, "80 W"), (2, "75 W")) + ONE + rows((3, "170 W"), (3, "180 W"))
    trace = read_gpu_log(write(ONE + lines), gpus=2)
    np.testing.assert_allclose(trace.power_kw, [0.15, 0.155, 0.35])


@pytest.mark.parametrize("missing", ["[N/A]", "N/A", "[Not Supported]", "[Unknown Error]", "ERR!", "[GPU is lost]"])
def test_a_missing_reading_is_a_gap_of_its_gpu(write, missing):
    lines = rows(
        (0, "0, 100 W"), (0, "1, 10 W"), (10, f"0, {missing}"), (10, "1, 20 W"), (20, "0, 200 W"), (20, "1, 30 W")
    )
    path = write(TWO + lines)
    with pytest.raises(TraceError, match=r"gpu.log, line 6: GPU 0: comes 20 s after the sample before, .* = 15"):
        read_gpu_log(path, max_gap_s=15.0)
    held = read_gpu_log(path, gaps="hold")
    np.testing.assert_allclose(held.power_kw, [0.11, 0.12, 0.23])
    np.testing.assert_allclose(read_gpu_log(path, max_gap_s=20.0).power_kw, held.power_kw)
    np.testing.assert_allclose(read_gpu_log(path, max_gap_s=None).power_kw, held.power_kw)
    np.testing.assert_allclose(read_gpu_log(path, max_gap_s=15.0, gaps="linear").power_kw, [0.11, 0.17, 0.23])


def test_a_log_with_long_intervals_has_no_gaps(write):
    # nvidia-smi -l 60 waits for 60 s after each round, and the GPUs report one after the other.
    def at(minute, text):
        return f"2023/11/16 18:{minute:02d}:{text}\n"

    lines = "".join(at(k, f"{4 * k + 3 * g:06.3f}, {g}, {100 + g} W") for k in range(10) for g in range(4))
    trace = read_gpu_log(write(TWO + lines))
    np.testing.assert_allclose(trace.time_s, 64.0 * np.arange(10))
    np.testing.assert_allclose(trace.power_kw, 0.406)
    late = "".join(at(k if k < 5 else k + 5, "00.000, 0, 100 W") for k in range(10))
    with pytest.raises(TraceError, match=r"line 7: GPU 0: comes 360 s after the sample before, more than .* = 3"):
        read_gpu_log(write(TWO + late))


def test_one_gpu_with_a_gap_that_a_column_tells_apart(write):
    path = write(TWO + rows(*((s, f"0, {100 + s} W") for s in (0, 1, 2, 3, 4, 30))))
    trace = read_gpu_log(path, gaps="linear")
    assert trace.time_s.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 17.0, 30.0]
    np.testing.assert_allclose(trace.power_kw[-3:], [0.104, 0.117, 0.13])
    assert trace.provenance.parameters["gpus"] == 1


def test_a_gpu_that_comes_late_or_leaves_early(write):
    late = rows(*((s, "0, 100 W") for s in range(0, 40, 10)), (30, "1, 10 W"), (40, "0, 100 W"), (40, "1, 20 W"))
    path = write(TWO + late)
    with pytest.raises(TraceError, match=r"line 6: GPU 1: its first reading comes 30 s after the first GPU, more than"):
        read_gpu_log(path, max_gap_s=15.0)
    trace = read_gpu_log(path, gaps="hold")
    assert trace.time_s.tolist() == [0.0, 10.0]
    np.testing.assert_allclose(trace.power_kw, [0.11, 0.12])
    path = write(TWO + rows((0, "0, 100 W"), (0, "1, 10 W"), *((s, "0, 90 W") for s in (10, 20, 30))))
    with pytest.raises(TraceError, match=r"line 3: GPU 1: its last reading comes 30 s before the end, more than"):
        read_gpu_log(path, max_gap_s=15.0)
    np.testing.assert_allclose(read_gpu_log(path, gaps="linear").power_kw, [0.11, 0.1, 0.1, 0.1])


LOST = "Unable to determine the device handle for GPU 0000:3B:00.0: GPU is lost."
ROUNDS = "".join(rows((s, "70 W"), (s + 0.002, "80 W"), (s + 0.004, "90 W")) for s in range(5))


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("", {}, r"gpu.log: is empty; give a log of `nvidia-smi --query-gpu=timestamp,index,power.draw"),
        ("# note\n", {}, r"gpu.log: is empty"),
        (ONE, {}, r"gpu.log: holds no reading"),
        (ONE + ONE_ROWS[:35], {}, r"gpu.log: 1 readings from when all 1 GPUs have reported; give at least 2"),
        (ONE + ONE_ROWS, {"gpus": 0}, r"gpus = 0 is below 1"),
        (ONE + ONE_ROWS, {"gpus": 5}, r"gpu.log: holds 3 GPUs, but gpus = 5"),
        (TWO + TWO_ROWS, {"gpus": 3}, r"gpu.log: holds 2 GPUs, but gpus = 3"),
        (ONE + ONE_ROWS, {"unit": "hp"}, r"gpu.log: unit 'hp' is unknown"),
        (ONE + ONE_ROWS, {"unit": "kW"}, r"line 1: 'power.draw \[W\]' names the unit W, but unit = 'kW'"),
        (ONE + ONE_ROWS, {"columns": "timestamp,power.draw"}, r"line 1: is a header; leave columns out"),
        (ONE + ONE_ROWS, {"limit_kw": -1.0}, r"limit_kw = -1.0"),
        (ONE + ONE_ROWS, {"gaps": "none"}, r"gaps = 'none' is unknown"),
        ("timestamp, index\n", {}, r"line 1: timestamp, index has no power.draw; log with"),
        (ONE_ROWS, {"columns": "power.draw"}, r"columns: power.draw has no timestamp"),
        ("hello\n", {}, r"line 1: is neither a header with timestamp nor a line with one time"),
        # Units that cannot be told.
        (ONE.replace("W", "BTU") + ONE_ROWS, {}, r"line 1: 'power.draw \[BTU\]' names the unit 'BTU'"),
        ("timestamp, power.draw\n" + rows((1, "70")), {}, r"line 2: power.draw is 70: has no unit, .*pass unit="),
        (ONE_ROWS.replace(" W", ""), {}, r"line 1: power.draw is 70.25: has no unit"),
        (rows((1, "0, 70.25")), {}, r"line 1: no cell from here to line 1 .* pass columns=.* unit="),
        (rows((1, "70 W, 400 W")), {}, r"line 1: 2 cells are power, 70 W, 400 W; pass columns="),
        (rows(*[(1, "[N/A]")] * 1001), {}, r"line 1: no cell from here to line 1000 is power"),
        (ONE + ONE_ROWS.replace("300.50 W", "0.3 kW"), {}, r"line 3: power.draw is 0.3 kW: the header or unit= says W"),
        (ONE_ROWS.replace("300.50 W", "300 hp"), {}, r"line 2: power.draw is 300 hp: its unit 'hp' is unknown"),
        # Values.
        (ONE + ONE_ROWS.replace("300.50", "-3"), {}, r"line 3: power.draw is -3 W, .*not negative"),
        (ONE + ONE_ROWS.replace("300.50", "30050"), {}, r"line 3: power.draw is 30050 W, above 2 kW, .*limit_kw"),
        # Times.
        (ONE + ONE_ROWS + rows((5.98, "1 W")), {}, r"line 5: the time repeats .*index.*or pass gpus="),
        (TWO + TWO_ROWS + rows((2, "0, 1 W")), {}, r"line 6: GPU 0: the time repeats"),
        (
            ONE + ONE_ROWS + ONE_ROWS,
            {},
            r"line 5: the time steps back by 2.001 s; .*summer time: .*TZ=UTC \(if several",
        ),
        (TWO + TWO_ROWS * 2, {}, r"line 6: GPU 0: the time steps back by 1 s; .*or log with TZ=UTC$"),
        (ONE + ONE_ROWS + rows((59, "1 W")), {}, r"line 5: comes 53.02 s after the sample before"),
        (ONE + ONE_ROWS + rows((61, "1 W")), {}, r"line 5: there is no time '2023/11/16 18:17:61.000'"),
        (ONE + ROUNDS, {}, r"line 3: comes 0.002 s after .*as if several GPUs .*index.*gpus= \(1 if"),
        # Nothing tells consumer cards apart by their serial number.
        (
            "timestamp, serial, power.draw [W]\n" + ROUNDS.replace(", ", ", [N/A], "),
            {},
            r"line 3: GPU \[N/A\]: comes 0.002 s",
        ),
        (TWO + TWO_ROWS + rows((2.006, "2, [N/A]")), {}, r"line 6: GPU 2: has no reading in the whole log; leave"),
        # Lines.
        (ONE + ONE_ROWS + LOST + "\n" + ONE_ROWS, {}, r"line 5: has 1 cells, not 2; repair or remove"),
        (ONE + ONE_ROWS + "soon, 1 W\n", {}, r"line 5: has the time 'soon' and the power '1 W'"),
        (ONE + ONE_ROWS + "2023/11/16 18:1\n", {}, r"line 5: has 1 cells"),
        (
            ONE + ONE_ROWS + ONE.replace("[W]", "[kW]"),
            {},
            r"line 5: is another header than timestamp, power.draw \[W\]",
        ),
    ],
)
@pytest.mark.parametrize("block_chars", [1, 1 << 22])
def test_bad_logs_are_named(write, text, options, message, block_chars):
    with mock.patch.object(text_file, "BLOCK_CHARS", block_chars), pytest.raises(TraceError, match=message):
        read_gpu_log(write(text), **options)


def test_one_gpu_with_an_uneven_pace_when_told(write):
    assert len(read_gpu_log(write(ONE + ROUNDS), gpus=1).time_s) == 15
    np.testing.assert_allclose(read_gpu_log(write(ONE + ROUNDS), gpus=3).power_kw[0], 0.24)


READINGS = st.lists(
    st.tuples(st.integers(0, 2), st.integers(1, 5_000), st.one_of(st.none(), st.integers(0, 200_000))), max_size=40
)


@given(READINGS, st.sampled_from([1, 100, 1 << 22]))
@pytest.mark.slow
def test_the_sum_is_that_of_each_gpu_held(tmp_path_factory, readings, block_chars):
    # Hundredths of a watt at milliseconds; every GPU reports at the beginning and at the end.
    readings = [(g, 1, 100 * g) for g in range(3)] + readings + [(g, 1, 1) for g in range(3)]
    ms = np.cumsum([step for _, step, _ in readings])
    gpu = np.array([g for g, _, _ in readings])
    power = np.array([np.nan if p is None else p for _, _, p in readings])
    text = TWO
    for at, g, p in zip(ms, gpu, power, strict=True):
        time = str(np.datetime64("2023-11-16T23:59:30.000", "ms") + at).replace("-", "/").replace("T", " ")
        text += f"{time}, {g}, {'[N/A]' if np.isnan(p) else f'{p / 100:.2f} W'}\n"
    path = tmp_path_factory.mktemp("logs") / "gpu.log"
    path.write_text(text, encoding="utf-8")
    # Rounds are another rule.
    with mock.patch.object(text_file, "BLOCK_CHARS", block_chars), mock.patch.object(meters, "ROUND_SHARE", -1.0):
        trace = read_gpu_log(path, gaps="hold", gpus=3)
    told = ~np.isnan(power)
    begin, expected = 2, []
    for i in np.flatnonzero(told & (ms >= ms[begin])):
        of_each = [power[np.flatnonzero(told & (gpu == g) & (ms <= ms[i]))[-1]] for g in range(3)]
        expected.append((ms[i] - ms[begin], sum(of_each)))
    np.testing.assert_allclose(trace.time_s * 1e3, [at for at, _ in expected], atol=1e-6)
    np.testing.assert_allclose(trace.power_kw * 1e5, [total for _, total in expected], atol=1e-6)
