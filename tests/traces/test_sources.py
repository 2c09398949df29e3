"""Named sources: what each promises, and the four inference tasks beside Fig. 2 of Chen and Zhang."""

from itertools import combinations

import numpy as np
import pytest

from dcgrid_env.traces import IDLE_SHARE, TRACE_SOURCES, PowerTrace, TraceError
from dcgrid_env.traces.sources import WAVES

TASKS = ("llama3-70b", "llama3-405b", "mixtral-8x22b", "deepseek-v3")
DENSE, EXPERTS = TASKS[:2], TASKS[2:]
GENERATORS = [
    (name, generate)
    for name, source in TRACE_SOURCES.items()
    for generate in (source.generate, source.shifted)
    if generate is not None
]
# Made of requests.
SERVED = ("chat", "code", "site", *TASKS)


@pytest.fixture(scope="module")
def seconds():
    """Eight half hours of each task, means over seconds, (8, 1800)."""
    return {
        task: np.array([TRACE_SOURCES[task].generate(1800.0, seed).resample(1.0) for seed in range(8)])
        for task in TASKS
    }


def distance(one, other):
    """The largest difference between two distributions (Kolmogorov and Smirnov)."""
    levels = np.sort(np.concatenate((one.ravel(), other.ravel())))
    shares = [np.searchsorted(np.sort(rows.ravel()), levels, side="right") / rows.size for rows in (one, other)]
    return np.abs(shares[0] - shares[1]).max()


def ramps(rows):
    """Changes from one second to the next beyond 5 % of the rating."""
    change = np.abs(np.diff(rows, axis=1)).ravel()
    return change[change > 0.05]


def test_sources_describe_themselves():
    assert list(TRACE_SOURCES) == [
        "inference",
        "training",
        "mixed",
        "step",
        "chat",
        "code",
        "site",
        *TASKS,
    ]
    for name, source in TRACE_SOURCES.items():
        assert source.name == name
        assert source.description
        assert "\n" not in source.description
        assert (source.shifted is None) == (name == "step")


@pytest.mark.parametrize(("source", "generate"), GENERATORS)
def test_every_generator_keeps_its_promises(source, generate):
    for seed in (0, 1_000_013):
        trace, again = generate(60.0, seed), generate(60.0, seed)
        assert isinstance(trace, PowerTrace)
        assert trace.duration_s == pytest.approx(60.0)
        assert trace.rated_kw == 1.0
        assert 0.97 * IDLE_SHARE - 1e-6 <= trace.power_kw.min() <= trace.power_kw.max() <= 1.0
        assert trace.compute_kw is not None
        assert trace.power_kw.tobytes() == again.power_kw.tobytes()
        assert trace.compute_kw.tobytes() == again.compute_kw.tobytes()
        assert (trace.requests is not None) == (source in SERVED)
    with pytest.raises(TraceError, match="seed = -1"):
        generate(60.0, -1)
    with pytest.raises(TraceError, match="duration_s"):
        generate(0.0, 1)


@pytest.mark.parametrize("source", [name for name, source in TRACE_SOURCES.items() if source.shifted])
def test_the_shifted_one_is_another(source):
    generate, shifted = TRACE_SOURCES[source].generate, TRACE_SOURCES[source].shifted
    assert shifted is not None
    # Hours of day and night alike; a mixed site is of three kinds in turn.
    levels = [np.concatenate([make(600.0, 6 * k).resample(10.0) for k in range(12)]) for make in (generate, shifted)]
    assert distance(*levels) > 0.1


def test_waves_come_about_once_a_minute():
    law = WAVES.arrivals
    assert law.calm_s + law.busy_s == 60.0
    assert law.calm_rate < 0.2


def test_all_tasks_get_the_same_waves(seconds):
    served = [TRACE_SOURCES[task].generate(600.0, 3).requests for task in TASKS]
    for times in served:
        assert times is not None
        assert served[0] is not None
        np.testing.assert_array_equal(times.arrival_s, served[0].arrival_s)
    # So they rise and fall together, each in its way.
    for one, other in combinations(TASKS, 2):
        assert np.corrcoef(seconds[one].ravel(), seconds[other].ravel())[0, 1] > 0.7


def test_tasks_look_different(seconds):
    for one, other in combinations(TASKS, 2):
        assert distance(seconds[one], seconds[other]) > 0.15, (one, other)


def test_a_task_draws_the_more_the_more_of_the_model_is_active(seconds):
    # 405, 70, 39 and 37 thousand million active parameters.
    mean = [seconds[task].mean() for task in ("llama3-405b", "llama3-70b", "mixtral-8x22b", "deepseek-v3")]
    assert (np.diff(mean) < -0.03).all()
    assert mean[0] > 0.75


def test_how_much_tasks_swing(seconds):
    # The largest dense model works all the time and swings least for its level; a mixture of experts answers few
    # requests quickly and falls idle between waves. Of the two medium ones Mixtral swings more than any dense model.
    relative = {task: seconds[task].std() / seconds[task].mean() for task in TASKS}
    assert min(relative, key=relative.__getitem__) == "llama3-405b"
    for dense in DENSE:
        for experts in EXPERTS:
            assert seconds[experts].std() > 1.15 * seconds[dense].std()


@pytest.mark.parametrize("task", TASKS)
def test_ramps_of_10_to_20_percent(seconds, task):
    large = ramps(seconds[task])
    small, middle, steep = (
        np.mean((large > low) & (large <= low + w)) for low, w in ((0.05, 0.05), (0.1, 0.1), (0.2, 1))
    )
    # Beyond noise, ramps of this size are the most frequent ones of the mixtures of experts. Those of the dense models
    # are smaller, but one in five is of this size and hardly any is steeper.
    if task in EXPERTS:
        assert middle > max(small, steep)
    else:
        assert middle > 0.2
        assert steep < 0.05


@pytest.mark.parametrize("task", TASKS)
def test_valleys_and_peaks_come_back_with_the_waves(seconds, task):
    level = seconds[task] - seconds[task].mean(axis=1, keepdims=True)
    lags = np.arange(30, 100)
    together = [(level[:, :-lag] * level[:, lag:]).mean() / (level * level).mean() for lag in lags]
    assert 55 <= lags[np.argmax(together)] <= 65
    assert max(together) > 0.25
    assert min(together) < -0.2
