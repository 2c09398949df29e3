"""Generated training: iterations, dips, starts, stops, failures, and several jobs a site."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env.traces import AWAKE_SHARE, IDLE_SHARE, TraceError, TrainingParams, generate_training
from dcgrid_env.traces.training.params import _RANGES
from dcgrid_env.traces.training.smoothing import PowerSmoothing
from dcgrid_env.traces.training.waveform import draw_job, run_edges

# One endless job over the whole site, with nothing but iterations.
STEADY = TrainingParams(
    n_slots=(1, 1),
    job_mean_s=1e9,
    failure_mean_s=1e9,
    iteration_spread=0.0,
    exchange_fraction=(0.3, 0.3),
    checkpoint_every_s=(1e9, 1e9),
    stall_every_s=(1e9, 1e9),
    waiting_share=(0.3, 0.3),
)


def lengths(mask):
    """Return the lengths of the runs in which `mask` is true, except those that touch an end."""
    edges = np.flatnonzero(np.diff(mask.astype(int)))
    return np.diff(edges)[int(mask[0]) :: 2]


@pytest.mark.parametrize("seed", range(4))
def test_any_step_holds_the_same_energy(seed):
    trace = generate_training(210.0, seed)
    for dt_s in (0.1, 0.5, 1.0, 7.0):
        assert trace.resample(dt_s).sum() * dt_s == pytest.approx(trace.energy_kws, rel=1e-9)
    np.testing.assert_allclose(trace.resample(0.1).reshape(-1, 10).mean(axis=1), trace.resample(1.0), rtol=1e-12)


def test_alternates_at_its_frequency():
    params = replace(STEADY, iteration_hz=(0.5, 0.5), exchange_fraction=(0.25, 0.25))
    tenth = generate_training(200.0, 1, params).resample(0.1)
    assert tenth.max() >= 0.9
    assert 0.28 <= tenth.min() <= 0.4
    # Two seconds an iteration: power falls once in each.
    assert 99 <= np.count_nonzero((tenth[:-1] > 0.8) & (tenth[1:] <= 0.8)) <= 101
    assert 0.7 < np.mean(tenth > 0.8) <= 0.78


@pytest.mark.parametrize("hz", [0.2, 0.7, 1.3, 3.0])
def test_the_iteration_is_the_peak_of_the_spectrum(hz):
    # Iterations that vary as by default widen the peak by a few bins.
    for params in (STEADY, replace(STEADY, iteration_spread=0.02)):
        tenth = generate_training(600.0, 2, replace(params, iteration_hz=(hz, hz))).resample(0.1)
        spectrum = np.abs(np.fft.rfft(tenth - tenth.mean()))
        assert np.fft.rfftfreq(len(tenth), 0.1)[spectrum.argmax()] == pytest.approx(hz, rel=0.03)


def test_three_iterations_a_second_show_at_a_tenth_and_vanish_at_a_second():
    trace = generate_training(300.0, 1, replace(STEADY, iteration_hz=(3.0, 3.0)))
    tenth, second = trace.resample(0.1), trace.resample(1.0)
    assert tenth.max() > 0.9
    assert tenth.min() < 0.6
    assert tenth.std() > 0.15
    assert np.ptp(second) < 0.02


def test_all_gpus_of_a_job_are_in_step():
    # One job on the whole site: its two levels are those of the site, and nothing lies between them for long.
    params = replace(STEADY, iteration_hz=(0.2, 0.2), compute_share=(0.95, 0.95), exchange_share=(0.3, 0.3))
    tenth = generate_training(300.0, 1, params).power_kw
    assert tenth.max() == pytest.approx(0.95, abs=1e-6)
    assert tenth.min() == pytest.approx(0.3, abs=1e-6)
    between = (tenth < 0.95 - 1e-6) & (tenth > 0.3 + 1e-6)
    assert between.mean() <= 2 / 50 + 1e-9


def test_several_jobs_share_a_site():
    params = replace(
        STEADY,
        n_slots=(3, 3),
        slot_evenness=1e6,
        job_mean_s=300.0,
        gap_mean_s=300.0,
        compute_share=(1.0, 1.0),
        exchange_fraction=(0.01, 0.01),
    )
    second = np.concatenate([generate_training(3600.0, seed, params).resample(1.0) for seed in range(3)])
    # With no, one, two or three of three jobs at work.
    for working in range(4):
        level = AWAKE_SHARE + (1.0 - AWAKE_SHARE) * working / 3
        assert np.mean(np.abs(second - level) < 0.04) > 0.05


def test_jobs_on_one_site_keep_their_own_frequency():
    params = replace(STEADY, n_slots=(2, 2), slot_evenness=1e6, gap_mean_s=1.0, iteration_hz=(0.2, 1.0))
    two = 0
    for seed in range(8):
        tenth = generate_training(600.0, seed, params).resample(0.1)
        spectrum = np.abs(np.fft.rfft(tenth - tenth.mean()))
        hz = np.fft.rfftfreq(len(tenth), 0.1)
        multiple = hz / hz[spectrum.argmax()]
        # A peak that is no multiple of the highest one belongs to the other job.
        other = np.abs(multiple - np.round(multiple)) > 0.02
        two += spectrum[other].max() > 0.4 * spectrum.max()
    assert two >= 6


def test_a_run_loads_and_then_ramps_in_a_straight_line():
    params = replace(STEADY, loading_s=(20.0, 20.0), ramp_s=(6.0, 6.0), iteration_hz=(0.3, 0.3))
    rng = np.random.default_rng(1)
    job = draw_job(rng, params)
    edge_s, level = run_edges(rng, job, 60.0, False, params)
    assert edge_s[0] == 0.0
    assert (np.diff(edge_s) > 0).all()
    assert edge_s[-1] < 60.0
    assert (level[edge_s < 20.0] == 0.3).all()
    rising = (edge_s >= 20.0) & (edge_s < 20.0 + 0.7 / 0.3 - 1e-6)
    expected = 0.3 + (job.compute_share - 0.3) * (edge_s[rising] - 20.0 + 0.05) / 6.0
    np.testing.assert_allclose(level[rising], expected, rtol=1e-9)
    after = level[edge_s >= 26.0]
    assert set(after) == {job.compute_share, job.exchange_share}


def test_a_run_under_way_neither_loads_nor_ramps():
    rng = np.random.default_rng(1)
    job = draw_job(rng, STEADY)
    edge_s, level = run_edges(rng, job, 60.0, True, STEADY)
    assert edge_s[0] == 0.0
    np.testing.assert_array_equal(level, np.resize([job.compute_share, job.exchange_share], len(level)))


def test_starts_and_stops_fall_within_a_trace():
    params = replace(STEADY, job_mean_s=200.0, gap_mean_s=60.0, loading_s=(20.0, 20.0))
    starts = stops = 0
    for seed in range(8):
        tenth = generate_training(900.0, seed, params).resample(0.1)
        idle = tenth <= AWAKE_SHARE
        starts += np.count_nonzero(idle[:-1] & ~idle[1:])
        stops += np.count_nonzero((tenth[:-2] > 0.85) & idle[2:])
    assert starts >= 15
    assert stops >= 10


def test_a_failure_drops_the_job_at_once_and_it_comes_back():
    params = replace(STEADY, failure_mean_s=200.0, restart_s=(60.0, 60.0), loading_s=(10.0, 10.0), iteration_hz=(2, 2))
    failures = 0
    for seed in range(4):
        tenth = generate_training(1800.0, seed, params).resample(0.1)
        idle = tenth <= AWAKE_SHARE
        down = lengths(idle)
        failures += len(down)
        assert set(down) <= {599, 600}
        for begin in np.flatnonzero(~idle[:-1] & idle[1:]) + 1:
            # At most the step of the failure lies between work, or loading, and idle.
            assert begin < 2 or tenth[begin - 2] >= 0.28
        for end in np.flatnonzero(idle[:-1] & ~idle[1:]) + 1:
            # It loads again, if it does not fail anew meanwhile.
            np.testing.assert_allclose(tenth[end + 1 : end + 2], 0.3, atol=1e-6)
    assert failures >= 10


def test_without_failures_a_job_runs_on():
    tenth = generate_training(7200.0, 1, STEADY).resample(0.1)
    assert tenth.min() > AWAKE_SHARE


def test_checkpoints_last_as_long_as_asked():
    params = replace(STEADY, iteration_hz=(2, 2), checkpoint_every_s=(60.0, 60.0), checkpoint_s=(8.0, 8.0))
    low = generate_training(1200.0, 3, params).resample(0.1) < 0.45
    writing = lengths(low)
    writing = writing[writing > 10]
    assert 1200 / 68 - 2 <= len(writing) <= 1200 / 68 + 1
    # With the exchange that it prolongs, of 0.15 s.
    assert set(writing) <= {80, 81, 82}


def test_stalls_come_and_go():
    params = replace(STEADY, iteration_hz=(2, 2), stall_every_s=(30.0, 30.0), stall_s=(0.5, 3.0))
    low = np.concatenate([generate_training(1200.0, s, params).resample(0.1) < 0.45 for s in range(4)])
    dips = lengths(low)
    dips = dips[dips > 5]
    assert 100 <= len(dips) <= 220
    assert dips.max() <= 33
    assert len(np.unique(dips)) > 10


def test_has_checkpoints_starts_and_stops():
    params = TrainingParams(n_slots=(1, 1), job_mean_s=600.0, gap_mean_s=120.0)
    dips, idles = 0, 0
    for seed in range(6):
        second = generate_training(3600.0, seed, params).resample(1.0)
        dips += np.count_nonzero(lengths(second < 0.45) >= 3)
        idles += np.count_nonzero(second < 0.28)
        # Within an hour, compute holds the longest share.
        assert np.median(second) > 0.5
    assert dips >= 20
    assert idles >= 600


def test_compute_is_what_lies_above_idle_while_a_job_runs():
    params = replace(STEADY, iteration_hz=(0.5, 0.5), job_mean_s=300.0, gap_mean_s=100.0)
    trace = generate_training(1800.0, 1, params)
    assert trace.compute_kw is not None
    idle = trace.power_kw <= AWAKE_SHARE
    assert idle.any()
    # A step in which a job starts or ends holds some of the idle draw.
    working = trace.power_kw >= 0.3 - 1e-6
    np.testing.assert_allclose(trace.compute_kw[working], trace.power_kw[working] - IDLE_SHARE, atol=0.045)
    assert (trace.compute_kw[idle] == 0.0).mean() > 0.99


@settings(max_examples=60, deadline=None)
@given(duration_s=st.floats(0.1, 7200.0), seed=st.integers(0, 2**63))
@pytest.mark.slow
def test_any_duration_and_seed_stay_in_bounds(duration_s, seed):
    check_bounds(duration_s, seed, None)


@st.composite
def any_params(draw):
    """Draw valid parameters over their whole ranges, except for fewer slots."""
    chosen = {}
    for name, (low, high) in _RANGES.items():
        if name == "n_slots":
            chosen[name] = tuple(sorted(draw(st.tuples(st.integers(1, 6), st.integers(1, 6)))))
        elif isinstance(getattr(TrainingParams(), name), tuple):
            chosen[name] = tuple(sorted(draw(st.tuples(st.floats(low, high), st.floats(low, high)))))
        else:
            chosen[name] = draw(st.floats(low, high))
    floor = chosen["compute_share"][0]
    for name in ("exchange_share", "waiting_share"):
        chosen[name] = tuple(min(share, floor) for share in chosen[name])
    chosen["smoothing"] = draw(st.sampled_from([None, PowerSmoothing(), PowerSmoothing(0.9, 0.01, 0.01, 60.0)]))
    return TrainingParams(**chosen)


@settings(max_examples=60, deadline=None)
@given(duration_s=st.floats(0.1, 600.0), seed=st.integers(0, 2**63), params=any_params())
@pytest.mark.slow
def test_any_parameters_stay_in_bounds(duration_s, seed, params):
    check_bounds(duration_s, seed, params)


def check_bounds(duration_s, seed, params):
    trace = generate_training(duration_s, seed, params)
    assert duration_s - 1e-9 <= trace.duration_s < duration_s + 0.1 + 1e-6
    assert trace.power_kw.min() >= IDLE_SHARE
    assert trace.power_kw.max() <= 1.0
    assert trace.compute_kw is not None
    assert ((trace.compute_kw >= 0) & (trace.compute_kw <= trace.power_kw)).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"iteration_hz": (3.0, 0.2)}, r"TrainingParams.iteration_hz = \(3.0, 0.2\) is not a rising pair within"),
        ({"iteration_hz": (0.2, 9.0)}, r"TrainingParams.iteration_hz = \(0.2, 9.0\) .* 0.01 to 5"),
        ({"iteration_hz": 1.0}, r"TrainingParams.iteration_hz = 1.0 is not a rising pair"),
        ({"compute_share": (0.9, 1.1)}, r"TrainingParams.compute_share = \(0.9, 1.1\)"),
        ({"exchange_share": (0.5, 0.95)}, r"TrainingParams.exchange_share = \(0.5, 0.95\) reaches above compute_share"),
        ({"waiting_share": (0.1, 0.3)}, r"TrainingParams.waiting_share = \(0.1, 0.3\)"),
        ({"job_mean_s": 0.0}, r"TrainingParams.job_mean_s = 0.0 is not in 10 to 1e\+09"),
        ({"failure_mean_s": np.nan}, r"TrainingParams.failure_mean_s = nan"),
        ({"iteration_spread": 0.9}, r"TrainingParams.iteration_spread = 0.9 is not in 0 to 0.2"),
        ({"n_slots": (0, 2)}, r"TrainingParams.n_slots = \(0, 2\)"),
        ({"n_slots": (1.0, 2.0)}, r"TrainingParams.n_slots = \(1.0, 2.0\) is not a pair of integers"),
        ({"smoothing": 0.5}, r"TrainingParams.smoothing = 0.5 is not a PowerSmoothing or None"),
    ],
)
def test_bad_parameters_are_named(options, message):
    with pytest.raises(TraceError, match=message):
        TrainingParams(**options)
