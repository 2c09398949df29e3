"""The recorder against a fake NVML and a fake clock: schedule, jitter, metadata, faults, and a file that reads back."""

import gzip
import json
import re
import subprocess
import sys
from importlib.metadata import distributions
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from dcgrid_env.traces import PowerTrace, TraceError, nvml, recorder

READING_S = 0.001
"""What each reading of power takes on the fake clock."""


class NVMLError(Exception):
    pass


class Clock:
    """A clock that only sleeping, readings and the test move."""

    def __init__(self):
        self.now_s = 100.0
        self.late_s = {}
        """Oversleeping, s, by the count of sleeps."""
        self.slept = 0

    def __call__(self):
        return self.now_s

    def sleep(self, wait_s):
        assert wait_s > 0
        self.now_s += wait_s + self.late_s.get(self.slept, 0.0)
        self.slept += 1


class FakeNvml:
    """Stands for the module pynvml and notes every function that is called."""

    NVMLError = NVMLError
    NVML_SUCCESS, NVML_CLOCK_SM, NVML_CLOCK_MEM, NVML_FI_DEV_POWER_INSTANT = 0, 1, 2, 186

    def __init__(self, clock, n_gpu=2):
        self.clock, self.n_gpu, self.called = clock, n_gpu, []
        self.instant = dict.fromkeys(range(n_gpu), True)
        self.at_reading = {}
        """What to do at a reading, by the count of readings."""
        self.readings = 0
        self.missing = set()
        """Functions that this GPU does not support."""

    def __getattr__(self, name):
        if not name.startswith("nvml"):
            raise AttributeError(name)

        def call(*arguments):
            self.called.append(name)
            if name in self.missing:
                raise NVMLError("Not Supported")
            return getattr(self, "_" + name.removeprefix("nvml").removeprefix("DeviceGet"))(*arguments)

        return call

    def _Init(self):
        pass

    _Shutdown = _Init

    def _SystemGetDriverVersion(self):
        return "550.54"

    def _Count(self):
        return self.n_gpu

    def _HandleByIndex(self, index):
        return index

    def _Name(self, gpu):
        return "NVIDIA H100"

    def _UUID(self, gpu):
        return f"GPU-{gpu}"

    def _EnforcedPowerLimit(self, gpu):
        return 700_000

    def _MaxClockInfo(self, gpu, kind):
        return {1: 1980, 2: 2619}[kind]

    def _ClockInfo(self, gpu, kind):
        return {1: 1200 + 15 * (self.readings % 3), 2: 2619}[kind]

    def milliwatts(self, gpu):
        self.at_reading.get(self.readings, lambda: None)()
        self.readings += 1
        self.clock.now_s += READING_S
        return 100_000 * (gpu + 1) + 123

    def _FieldValues(self, gpu, fields):
        assert fields == [186]
        if not self.instant[gpu]:
            return [SimpleNamespace(nvmlReturn=3)]
        return [SimpleNamespace(nvmlReturn=0, value=SimpleNamespace(uiVal=self.milliwatts(gpu)))]

    def _PowerUsage(self, gpu):
        return self.milliwatts(gpu) + 1000


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def fake(clock, monkeypatch):
    fake = FakeNvml(clock)
    monkeypatch.setitem(sys.modules, "pynvml", fake)
    return fake


@pytest.fixture
def record(fake, clock, tmp_path):
    def call(name="site.csv", **options):
        return recorder.record(tmp_path / name, clock=clock, sleep=clock.sleep, **options)

    return call


def read(path):
    """The first line's JSON, the header and the rows."""
    first, header, *rows = path.read_text().splitlines()
    assert first.startswith("# dcgrid trace {")
    return json.loads(first.removeprefix("# dcgrid trace ")), header, np.array([row.split(",") for row in rows], float)


def left(folder):
    return {path.name for path in folder.iterdir()}


def fail(error):
    def act():
        raise error

    return act


def test_ten_seconds_at_20_hz(record, fake, tmp_path):
    said = record(hz=20, duration_s=10)
    told, header, rows = read(tmp_path / "site.csv")
    assert left(tmp_path) == {"site.csv"}
    assert told == said
    assert header == "time_s,gpu0_w,gpu1_w"
    # The last sample ends the last period; each lies in the middle of two readings.
    np.testing.assert_allclose(rows[:, 0], np.arange(201) / 20 + READING_S, atol=1e-6)
    assert rows[:, 1:].tolist() == [[100.123, 200.123]] * 201
    assert {key: said[key] for key in ("hz", "samples", "missed", "ended", "driver")} == {
        "hz": 20.0,
        "samples": 201,
        "missed": 0,
        "ended": "complete",
        "driver": "550.54",
    }
    assert said["jitter_s"] == {"mean": 0.001, "p99": 0.001, "max": 0.001}
    assert said["gpus"][1] == {
        "index": 1,
        "name": "NVIDIA H100",
        "uuid": "GPU-1",
        "power_reading": "NVML_FI_DEV_POWER_INSTANT",
        "power_limit_w": 700.0,
        "max_sm_clock_mhz": 1980,
        "max_memory_clock_mhz": 2619,
        "memory_clock_mhz": 2619,
        "sm_clock_mhz": {"start": 1215, "end": 1230, "min": 1200, "mean": 1215.0, "max": 1230},
    }


@pytest.mark.parametrize("name", ["site.csv", "site.csv.gz"])
def test_the_file_reads_back(record, tmp_path, name):
    said = record(name, hz=20, duration_s=10)
    trace = PowerTrace.from_csv(tmp_path / name)
    assert trace.duration_s == pytest.approx(10)
    assert trace.energy_kws == pytest.approx(0.300246 * 10)
    assert trace.provenance.parameters == said
    if name.endswith(".gz"):
        assert gzip.decompress((tmp_path / name).read_bytes()).startswith(b"# dcgrid trace {")


def test_lateness_does_not_add_up(record, clock, tmp_path):
    clock.late_s = dict.fromkeys(range(1000), 0.004)
    said = record(hz=20, duration_s=10)
    _, _, rows = read(tmp_path / "site.csv")
    # The first sample is due at once; no sleep, no lateness.
    np.testing.assert_allclose(rows[1:, 0], np.arange(1, 201) / 20 + 0.004 + READING_S, atol=1e-6)
    assert said["missed"] == 0
    assert said["jitter_s"]["max"] == pytest.approx(0.005)


def test_what_is_late_is_taken_once_and_not_made_up_for(record, clock, tmp_path):
    # The fifth sample comes 3.4 periods late: three are missed, the fourth is taken at once, the next is on time.
    clock.late_s = {4: 0.34}
    said = record(hz=10, duration_s=2)
    _, _, rows = read(tmp_path / "site.csv")
    expected = np.array([0, 1, 2, 3, 4, 8.4, *range(9, 21)]) / 10 + READING_S
    np.testing.assert_allclose(rows[:, 0], expected, atol=1e-6)
    assert (said["samples"], said["missed"]) == (18, 3)
    assert said["jitter_s"]["max"] == pytest.approx(0.041)
    assert said["jitter_s"]["mean"] == pytest.approx((18 * READING_S + 0.04) / 18, abs=1e-6)


def test_late_at_the_end(record, clock):
    clock.late_s = {8: 1.0}
    said = record(hz=10, duration_s=1)
    assert (said["samples"], said["missed"], said["ended"]) == (10, 1, "complete")


def test_readings_slower_than_the_rate(record, fake, clock, tmp_path):
    for i in range(1000):
        fake.at_reading[i] = lambda: setattr(clock, "now_s", clock.now_s + 0.07)
    said = record(hz=10, duration_s=3)
    times_s = read(tmp_path / "site.csv")[2][:, 0]
    assert np.diff(times_s).min() > 0.1
    assert said["samples"] + said["missed"] == 31
    assert said["missed"] > 5


@pytest.mark.parametrize("supported", [[], [1]])
def test_gpus_without_the_instantaneous_reading(record, fake, tmp_path, supported):
    fake.instant = {0: 0 in supported, 1: 1 in supported}
    said = record(duration_s=1)
    readings = ["NVML_FI_DEV_POWER_INSTANT" if i in supported else "nvmlDeviceGetPowerUsage" for i in (0, 1)]
    assert [gpu["power_reading"] for gpu in said["gpus"]] == readings
    assert read(tmp_path / "site.csv")[2][0, 1:].tolist() == [101.123, 200.123 if supported else 201.123]


def test_an_old_driver_without_field_values(record, fake):
    fake.missing = {"nvmlDeviceGetFieldValues", "nvmlDeviceGetClockInfo", "nvmlDeviceGetEnforcedPowerLimit"}
    gpu = record(duration_s=1)["gpus"][0]
    assert (gpu["power_reading"], gpu["power_limit_w"], gpu["sm_clock_mhz"]) == ("nvmlDeviceGetPowerUsage", None, None)


def test_chosen_gpus(record, tmp_path):
    said = record(duration_s=1, gpus=[1])
    assert [gpu["index"] for gpu in said["gpus"]] == [1]
    _, header, rows = read(tmp_path / "site.csv")
    assert (header, rows[0, 1]) == ("time_s,gpu1_w", 200.123)


def test_stop_and_progress(record):
    steps = []
    said = record(progress=lambda time_s, power_w: steps.append((time_s, power_w)), stop=lambda: len(steps) == 7)
    assert (said["samples"], said["ended"]) == (7, "stopped")
    assert steps[6] == (pytest.approx(0.6 + READING_S), pytest.approx(300.246))


def test_an_interrupt_ends_the_recording_and_keeps_it(record, fake, tmp_path):
    fake.at_reading[2 + 2 * 30 + 1] = fail(KeyboardInterrupt)  # 2 probes, 30 samples, and half of one
    said = record()
    assert (said["samples"], said["ended"]) == (30, "interrupted")
    assert PowerTrace.from_csv(tmp_path / "site.csv").duration_s == pytest.approx(2.9)
    assert left(tmp_path) == {"site.csv"}
    assert fake.called[-1] == "nvmlShutdown"


def test_a_gpu_that_is_lost_on_the_way(record, fake, tmp_path):
    fake.at_reading[2 + 2 * 30 + 1] = fail(NVMLError("GPU is lost"))
    fault = r"GPU 1 \(NVIDIA H100\) gives no power reading \(GPU is lost\)"
    with pytest.raises(TraceError, match=rf"{fault}; the 30 samples before are kept in .*site\.csv"):
        record()
    told, _, rows = read(tmp_path / "site.csv")
    assert (len(rows), told["samples"]) == (30, 30)
    assert re.fullmatch(fault, told["ended"])
    assert fake.called[-1] == "nvmlShutdown"


@pytest.mark.parametrize("error", [KeyboardInterrupt(), NVMLError("GPU is lost")])
def test_less_than_two_samples_are_not_kept(record, fake, tmp_path, error):
    fake.at_reading[4] = fail(error)
    with pytest.raises(TraceError, match=r"ended after 1 samples and a trace needs 2; nothing is kept"):
        record()
    assert left(tmp_path) == set()


def test_a_crash_leaves_rows_that_read(record, tmp_path):
    def crash(time_s, power_w):
        if time_s > 1:
            raise OSError("No space left on device")

    def crash_at_once(time_s, power_w):
        raise OSError("No space left on device")

    with pytest.raises(OSError, match="No space left"):
        record("site.csv.gz", progress=crash_at_once)
    assert left(tmp_path) == set()
    with pytest.raises(OSError, match="No space left"):
        record("site.csv.gz", progress=crash)
    assert left(tmp_path) == {"site.csv.part"}
    assert PowerTrace.from_csv(tmp_path / "site.csv.part").duration_s == pytest.approx(1.0)
    with pytest.raises(TraceError, match=r"site\.csv\.part is there: another recording is running, or one was cut off"):
        record("site.csv.gz", overwrite=True)


def test_a_file_that_is_there_is_replaced_only_when_told(record, fake, tmp_path):
    path = tmp_path / "site.csv"
    path.write_text("mine")
    with pytest.raises(TraceError, match=r"site\.csv is there already; choose another name or pass overwrite"):
        record(duration_s=1)
    assert (path.read_text(), fake.called) == ("mine", [])
    record(duration_s=1, overwrite=True)
    assert read(path)[0]["samples"] == 11


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"hz": 0}, r"hz = 0 is not above 0 and at most 20"),
        ({"hz": 20.1}, r"hz = 20.1 is not above 0"),
        ({"hz": float("nan")}, r"hz = nan"),
        ({"duration_s": -1.0}, r"duration_s = -1.0 is not a finite number above 0"),
        ({"hz": 2, "duration_s": 0.4}, r"duration_s = 0.4 is shorter than one period of 0.5 s"),
        ({"gpus": [0, 2]}, r"GPU 2 is not there; the machine has 0 to 1"),
        ({"gpus": [-1]}, r"GPU -1 is not there"),
        ({"gpus": [1, 1]}, r"gpus is \[1, 1\]; name at least one and none twice"),
        ({"gpus": []}, r"gpus is \[\]"),
        ({"name": "absent/site.csv"}, r"there is no folder .*absent; make it first"),
        ({"name": ".", "overwrite": True}, r"is there already; choose another name$"),
    ],
)
def test_what_cannot_be_is_refused_before_a_file_is_begun(record, tmp_path, options, message):
    with pytest.raises(TraceError, match=message):
        record(**options)
    assert left(tmp_path) == set()


@pytest.mark.parametrize(
    ("missing", "message"),
    [
        ("nvmlInit", r"NVML does not start \(Not Supported\); recording needs an NVIDIA GPU and its driver"),
        ("nvmlDeviceGetHandleByIndex", r"GPU 0 cannot be opened \(Not Supported\); name others with gpus"),
    ],
)
def test_a_machine_that_cannot_be_read(record, fake, tmp_path, missing, message):
    fake.missing = {missing}
    with pytest.raises(TraceError, match=message):
        record()
    assert left(tmp_path) == set()


def test_a_gpu_without_power_reading(record, fake):
    fake.missing = {"nvmlDeviceGetFieldValues", "nvmlDeviceGetPowerUsage"}
    with pytest.raises(TraceError, match=r"GPU 0 \(NVIDIA H100\) gives no power reading .*leave it out"):
        record()
    assert fake.called[-1] == "nvmlShutdown"


def test_a_machine_without_gpu(record, fake):
    fake.n_gpu = 0
    with pytest.raises(TraceError, match="no NVIDIA GPU"):
        record()


def test_without_the_package_the_extra_is_named(record, monkeypatch):
    monkeypatch.setitem(sys.modules, "pynvml", None)
    with pytest.raises(TraceError, match=r"pip install -e '\.\[record\]'"):
        record()


def test_nothing_is_set(record, fake):
    record(duration_s=1)
    assert (fake.called[0], fake.called[-1]) == ("nvmlInit", "nvmlShutdown")
    assert all(re.match("nvml(System|Device)Get[A-Z]", name) for name in fake.called[1:-1])
    for module in (nvml, recorder):
        source = Path(str(module.__file__)).read_text()
        assert not re.findall(r"nvml\w*(?:Set|Reset|Clear|Modify|Create|Destroy|Enable|Disable)\w*", source)


@pytest.mark.skipif(not list(distributions(name="nvidia-ml-py")), reason="nvidia-ml-py is not installed")
def test_the_real_module_has_what_is_used(record, fake):
    fake.instant = {0: True, 1: False}
    record(duration_s=1)
    used = {*fake.called, *(name for name in vars(FakeNvml) if name.startswith("NVML"))}
    code = "import sys, pynvml; print([name for name in sys.argv[1:] if not hasattr(pynvml, name)])"
    done = subprocess.run([sys.executable, "-c", code, *used], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_real_time(fake, tmp_path):
    said = recorder.record(tmp_path / "site.csv", hz=20, duration_s=0.2)
    assert said["samples"] + said["missed"] == 5
