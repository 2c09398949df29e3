"""Relays and capacitor controls against OpenDSS's own, in time mode with steps of a second.

OpenDSS queues an action for each tap. It cannot take back the action that it queued after a tap of a sequence: the
action stays when the volts return into band, and a regulator can then have two sequences at once, with taps closer
together than ``tapdelay``. And it ends a sequence where the volts before a tap lacked less than 1.5 taps, whatever they
are afterwards. ``queued_taps`` repeats this with our power flow and agrees on every tap. Our regulators have one drive
each and go by what they measure, so they differ from OpenDSS after such moments.
"""

from collections import Counter
from typing import Any

import numpy as np
import pytest

from dcgrid_env import load_feeder, make_scenario
from dcgrid_env.baselines import make_controller, rollout
from dcgrid_env.devices.tap_changer.relay import relay_settings, relay_volts
from dcgrid_env.devices.tap_changer.settling import settled_taps
from dcgrid_env.engine.physics import dynamics
from dcgrid_env.engine.physics import equipment as feeder_equipment
from dcgrid_env.engine.physics.dynamics import solve_rows_of
from dcgrid_env.powerflow import Control, solve_unbalanced

pytest.importorskip("dss", reason="OpenDSSDirect.py is not installed")

FEEDERS = ("ieee13-3ph", "ieee34-3ph", "ieee123-3ph")
SECONDS = 300


def moving_loads(feeder, seed, seconds=SECONDS):
    """Loads of each second, kW and kvar, (seconds + 1, n_leg): jumps of all, wandering of each, nominal at t = 0."""
    rng = np.random.default_rng(seed)
    jumps = rng.random(seconds + 1) < 0.08
    levels = rng.uniform(0.4, 1.35, seconds + 1)
    last_jump = np.maximum.accumulate(np.where(jumps, np.arange(seconds + 1), 0))
    wandering = 1.0 + 0.015 * np.cumsum(rng.normal(size=(seconds + 1, feeder.n_leg)), axis=0)
    share = levels[last_jump][:, None] * np.clip(wandering, 0.5, 1.5)
    share[0] = 1.0
    return share * feeder.p_load_kw, share * feeder.q_load_kvar


def played_loads(name, controller, monkeypatch, seeds=range(16)):
    """Net loads of episodes of a preset under a controller, kW and kvar, (episode, second, n_leg)."""
    loads, net_loads = [], dynamics.net_loads

    def kept(*args):
        loads.append([np.array(power) for power in net_loads(*args)])
        return net_loads(*args)

    monkeypatch.setattr(dynamics, "net_loads", kept)
    scenario = make_scenario(name)
    rollout(scenario, make_controller(controller, scenario), list(seeds))
    return np.array(loads).transpose(1, 2, 0, 3)


def moved(before, after, second):
    return [(second, int(i), int(after[i])) for i in np.flatnonzero(np.asarray(after) != before)]


def initial_taps(feeder, p_kw, q_kvar):
    return settled_taps(feeder, p_kw[:1], q_kvar[:1]).tap


def engine_taps(name, p_kw, q_kvar, dt_s=1, timer="reset", overrides: Any = None):
    """(second, regulator, tap) after each step of the engine, with loads constant over ``dt_s`` seconds; the end."""
    settings = {"grid_control.regulator_settings": {"timer": timer}, "dt_s": float(dt_s), **(overrides or {})}
    scenario, taps = make_scenario(name, **settings), []
    solve = solve_rows_of(scenario, None, p_kw[:1], q_kvar[:1], None)
    equipment = feeder_equipment.begun(scenario, p_kw[:1], q_kvar[:1], None, None)
    equipment = feeder_equipment.measured(scenario, equipment, solve(equipment, slice(None), None))
    for second in range(1, len(p_kw), dt_s):
        solve = solve_rows_of(scenario, None, p_kw[second : second + 1], q_kvar[second : second + 1], None)
        before, equipment = equipment, feeder_equipment.advanced(scenario, equipment, ())
        solution = solve(equipment, slice(None), None)
        equipment, _ = feeder_equipment.with_controls(scenario, equipment, solution, solve)
        taps += moved(before.regulators.tap[0], equipment.regulators.tap[0], second)
    return taps, equipment


def queued_taps(feeder, p_kw, q_kvar):
    """(second, regulator, tap) by OpenDSS's rule, and the second in which it first was not what a drive would do."""
    settings, taps, queue, names = relay_settings(feeder), [], [], iter(range(10**9))
    table, n = feeder.network.regulator, feeder.n_regulator
    tap, pending, armed = initial_taps(feeder, p_kw, q_kvar)[0], np.zeros(n), [None] * n
    first_apart, ended = np.inf, np.full(n, -np.inf)
    for second in range(1, len(p_kw)):
        before = tap.copy()
        while True:
            control = Control(feeder.tap_ratio(tap[None]))
            solution = solve_unbalanced(feeder, p_kw[second][None], q_kvar[second][None], control=control)
            missing_v = settings.target_v - relay_volts(settings, solution)[0]
            for i in range(n):
                inside = abs(missing_v[i]) <= 0.5 * table.band_v[i]
                if not inside and second == ended[i] + settings.tap_delay_s[i]:
                    first_apart = min(first_apart, second)
                pending[i] = 0.0 if inside else np.rint(missing_v[i] / settings.volts_per_tap[i, i])
                if inside and armed[i] is not None:
                    queue, armed[i] = [action for action in queue if action[2] != armed[i]], None
                elif pending[i] and armed[i] is None and abs(tap[i] + np.sign(pending[i])) <= 16:
                    armed[i] = next(names)
                    queue.append((second + settings.delay_s[i], i, armed[i]))
            if max(Counter(i for _, i, _ in queue).values(), default=0) > 1:
                first_apart = min(first_apart, second)
            due = [action for action in queue if action[0] <= second]
            if not due:
                break
            queue = [action for action in queue if action[0] > second]
            for _, i, _ in due:
                turn = np.sign(pending[i])
                tap[i], pending[i] = np.clip(tap[i] + turn, -16, 16), pending[i] - turn
                if pending[i]:
                    queue.append((second + settings.tap_delay_s[i], i, next(names)))
                else:
                    armed[i], ended[i] = None, second
        taps += moved(before, tap, second)
    return taps, first_apart


def opendss_circuit(feeder):
    from docs.studies.speed.opendss_circuit import OpenDss

    return OpenDss(feeder)


def opendss_taps(feeder, p_kw, q_kvar):
    """(second, regulator, tap) of each change of a tap in OpenDSS."""
    circuit, table, tap = opendss_circuit(feeder), feeder.network.regulator, initial_taps(feeder, p_kw, q_kvar)[0]
    text = circuit.dss.Text
    for k, name in enumerate(table.name):
        text.Command = f"Edit Transformer.{name} wdg=2 maxtap=1.1 mintap=0.9 numtaps=32"
        text.Command = (
            f"New RegControl.{name} transformer={name} winding=2 vreg={table.vreg_v[k]} band={table.band_v[k]} "
            f"ptratio={table.pt_ratio[k]} ctprim={table.ct_primary_a[k]} R={table.r_ldc_v[k]} X={table.x_ldc_v[k]} "
            f"delay={table.delay_s[k]} tapdelay={table.tap_delay_s[k]} "
            f"PTphase={1 + table.phases[k].index(table.sensed_phase[k])} maxtapchange={table.max_taps_per_move[k]}"
        )
    text.Command = "Set mode=duty stepsize=1s number=1 time=(0,0) controlmode=time"
    taps, transformers, solution = [], circuit.dss.ActiveCircuit.Transformers, circuit.dss.ActiveCircuit.Solution
    for second in range(1, len(p_kw)):
        circuit.set_point(p_kw[second], q_kvar[second], feeder.v0_pu, feeder.tap_ratio(tap), feeder.base_capacitor_on)
        solution.Solve()
        after = []
        for name in table.name:
            transformers.Name = name
            transformers.Wdg = 2
            after.append(round((transformers.Tap - 1.0) / 0.00625))
        taps += moved(tap, after, second)
        tap = np.array(after, float)
    return taps


def in_both(some, others):
    return sum((Counter(some) & Counter(others)).values())


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("name", FEEDERS)
def test_opendss_queue_explains_every_tap_and_ours_agree_while_it_acts_like_a_drive(name, seed):
    feeder = load_feeder(name)
    loads = moving_loads(feeder, seed)
    theirs, (queued, first_apart) = opendss_taps(feeder, *loads), queued_taps(feeder, *loads)
    assert len(theirs) > 10
    assert queued == theirs
    ours, _ = engine_taps(name, *loads)
    apart = (Counter(ours) - Counter(theirs)) + (Counter(theirs) - Counter(ours))
    assert not apart or min(second for second, _, _ in apart) >= first_apart


def test_preset_episodes_have_opendss_taps_at_its_seconds(monkeypatch):
    """Of each preset's sixteen episodes under the tuned droop and without control; figures in docs/three-phase.md."""
    agreed = asked = made = 0
    for name in FEEDERS:
        for controller in ("none", "droop-tuned"):
            for p_kw, q_kvar in zip(*played_loads(name, controller, monkeypatch), strict=True):
                theirs = opendss_taps(load_feeder(name), p_kw, q_kvar)
                ours, _ = engine_taps(name, p_kw, q_kvar)
                agreed, asked, made = agreed + in_both(ours, theirs), asked + len(theirs), made + len(ours)
            monkeypatch.undo()
    assert asked > 400
    assert agreed >= 0.995 * asked
    assert agreed >= 0.99 * made


@pytest.mark.parametrize("timer", ["reset", "integrating"])
@pytest.mark.parametrize("name", FEEDERS)
def test_the_step_length_does_not_move_a_tap(name, timer):
    """Loads that are constant over ten seconds; the taps and timers at the end of each ten."""
    loads = [np.concatenate((a[:1], np.repeat(a[1::10], 10, axis=0))) for a in moving_loads(load_feeder(name), 1)]
    (of_seconds, end), *others = (engine_taps(name, *loads, dt_s, timer) for dt_s in (1, 2, 5, 10))
    assert len(of_seconds) > 10
    for taps, other_end in others:
        last = {(second - 1) // 10 * 100 + i: tap for second, i, tap in of_seconds}
        assert {(second - 1) // 10 * 100 + i: tap for second, i, tap in taps} == last
        for field in ("tap", "relay_v", "out_of_band_s", "in_sequence", "since_s", "moves"):
            ours, theirs = getattr(end.regulators, field), getattr(other_end.regulators, field)
            np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-5, err_msg=field)
