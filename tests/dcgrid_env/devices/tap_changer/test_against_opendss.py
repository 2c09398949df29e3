"""Relays against OpenDSS's own controls, in time mode with steps of a second; docs/three-phase.md has the figures."""

from collections import Counter

import numpy as np
import pytest

from dcgrid_env import load_feeder

pytest.importorskip("dss", reason="OpenDSSDirect.py is not installed")

from docs.studies.grids.relays import (
    FEEDERS,
    PLAYED,
    agreement,
    engine_taps,
    moving_loads,
    opendss_taps,
    played_loads,
    queued_taps,
)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("name", FEEDERS)
@pytest.mark.slow
def test_opendss_queue_explains_every_tap_and_ours_agree_while_it_acts_like_a_drive(name, seed):
    feeder = load_feeder(name)
    loads = moving_loads(feeder, seed)
    theirs, (queued, first_apart) = opendss_taps(feeder, *loads), queued_taps(feeder, *loads)
    assert len(theirs) > 10
    assert queued == theirs
    ours, _ = engine_taps(name, *loads)
    apart = (Counter(ours) - Counter(theirs)) + (Counter(theirs) - Counter(ours))
    assert not apart or min(second for second, _, _ in apart) >= first_apart


@pytest.mark.slow
def test_preset_episodes_have_opendss_taps_at_its_seconds():
    played = [(name, played_loads(name, controller)) for name in FEEDERS for controller in PLAYED]
    asked, agreed, made = agreement((name, p, q) for name, loads in played for p, q in zip(*loads, strict=True))
    assert asked > 400
    assert agreed >= 0.98 * max(asked, made)  # 415 of 420; OpenDSS can run two sequences at once (decision 38)


@pytest.mark.parametrize("timer", ["reset", "integrating"])
@pytest.mark.parametrize("name", FEEDERS)
def test_the_step_length_does_not_move_a_tap(name, timer):
    """Loads that are constant over ten seconds; the taps and timers at the end of each ten."""
    p_kw, q_kvar = (
        np.concatenate((a[:1], np.repeat(a[1::10], 10, axis=0))) for a in moving_loads(load_feeder(name), 1)
    )
    (of_seconds, end), *others = (engine_taps(name, p_kw, q_kvar, dt_s, timer) for dt_s in (1, 2, 5, 10))
    assert len(of_seconds) > 10
    for taps, other_end in others:
        last = {(second - 1) // 10 * 100 + i: tap for second, i, tap in of_seconds}
        assert {(second - 1) // 10 * 100 + i: tap for second, i, tap in taps} == last
        for field in ("tap", "relay_v", "out_of_band_s", "in_sequence", "since_s", "moves"):
            ours, theirs = getattr(end.regulators, field), getattr(other_end.regulators, field)
            np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-5, err_msg=field)
