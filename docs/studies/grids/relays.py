"""Print how many taps of OpenDSS's controls the relays make at the same second.

`python -m docs.studies.grids.relays` replays episodes of three presets and loads that jump, in OpenDSS
(``controlmode=time``, steps of a second) and with ``timer="reset"``. It needs the extra ``bench`` or ``test``.

OpenDSS queues an action for each tap. It cannot take back the action that it queued after a tap of a sequence. The
action stays when the volts return into band. A regulator can then have two sequences at once, with taps closer together
than ``tapdelay``. And it ends a sequence if the volts before a tap lacked less than 1.5 taps, whatever they are
afterwards. ``queued_taps`` repeats this with our power flow and agrees on every tap. Our regulators have one drive
each and go by what they measure, so they differ from OpenDSS after such moments.
"""

from collections import Counter
from collections.abc import Iterable
from itertools import count
from unittest import mock

import numpy as np

from dcgrid_env import ThreePhaseFeeder, load_feeder, make_scenario
from dcgrid_env.baselines import make_controller, rollout
from dcgrid_env.devices.tap_changer.relay import relay_settings, relay_volts
from dcgrid_env.devices.tap_changer.settling import settled_taps
from dcgrid_env.engine.physics import dynamics
from dcgrid_env.engine.physics import equipment as feeder_equipment
from dcgrid_env.engine.physics.dynamics import solve_rows_of
from dcgrid_env.engine.physics.state import Equipment
from dcgrid_env.powerflow import Control, solve_unbalanced
from docs.studies.speed.opendss_circuit import OpenDss

FEEDERS = ("ieee13-3ph", "ieee34-3ph", "ieee123-3ph")
PLAYED = ("none", "droop-tuned")
"""Controllers of the episodes that are replayed."""
SECONDS = 300
Taps = list[tuple[int, int, int]]
"""Second, regulator and new tap of each change of a tap."""


def moving_loads(feeder: ThreePhaseFeeder, seed: int, seconds: int = SECONDS) -> tuple[np.ndarray, np.ndarray]:
    """Loads of each second, kW and kvar, (seconds + 1, n_leg): jumps of all, wandering of each, nominal at t = 0."""
    rng = np.random.default_rng(seed)
    jumps = rng.random(seconds + 1) < 0.08
    levels = rng.uniform(0.4, 1.35, seconds + 1)
    last_jump = np.maximum.accumulate(np.where(jumps, np.arange(seconds + 1), 0))
    wandering = 1.0 + 0.015 * np.cumsum(rng.normal(size=(seconds + 1, feeder.n_leg)), axis=0)
    share = levels[last_jump][:, None] * np.clip(wandering, 0.5, 1.5)
    share[0] = 1.0
    return share * feeder.p_load_kw, share * feeder.q_load_kvar


def played_loads(name: str, controller: str, seeds: Iterable[int] = range(16)) -> np.ndarray:
    """Net loads of episodes of a published preset under a controller, kW and kvar, (2, episode, second, n_leg)."""
    loads, net_loads = [], dynamics.net_loads

    def kept(*args):
        loads.append([np.array(power) for power in net_loads(*args)])
        return net_loads(*args)

    scenario = make_scenario(f"{name}-published")
    with mock.patch.object(dynamics, "net_loads", kept):
        rollout(scenario, make_controller(controller, scenario), list(seeds))
    return np.array(loads).transpose(1, 2, 0, 3)


def _moved(before: np.ndarray, after: np.ndarray, second: int) -> Taps:
    return [(second, int(i), int(after[i])) for i in np.flatnonzero(np.asarray(after) != before)]


def _initial_taps(feeder: ThreePhaseFeeder, p_kw: np.ndarray, q_kvar: np.ndarray) -> np.ndarray:
    return settled_taps(feeder, p_kw[:1], q_kvar[:1]).tap


def engine_taps(
    name: str, p_kw: np.ndarray, q_kvar: np.ndarray, dt_s: int = 1, timer: str = "reset"
) -> tuple[Taps, Equipment]:
    """The taps after each step of the engine, with loads constant over ``dt_s`` seconds, and the equipment then."""
    control = {"grid_control.regulator_settings": {"timer": timer}}
    scenario, taps = make_scenario(name, dt_s=float(dt_s), **control), []
    solve = solve_rows_of(scenario, None, p_kw[:1], q_kvar[:1], None)
    equipment = feeder_equipment.initial_equipment(scenario, p_kw[:1], q_kvar[:1], None, None, None)
    equipment = feeder_equipment.measured(scenario, equipment, solve(equipment, slice(None), None))
    for second in range(1, len(p_kw), dt_s):
        solve = solve_rows_of(scenario, None, p_kw[second : second + 1], q_kvar[second : second + 1], None)
        before, equipment = equipment, feeder_equipment.advanced(scenario, equipment, ())
        solution = solve(equipment, slice(None), None)
        equipment, _ = feeder_equipment.with_controls(scenario, equipment, (), None, solution, solve)
        taps += _moved(before.regulators.tap[0], equipment.regulators.tap[0], second)
    return taps, equipment


def queued_taps(feeder: ThreePhaseFeeder, p_kw: np.ndarray, q_kvar: np.ndarray) -> tuple[Taps, float]:
    """The taps by OpenDSS's rule, and the second in which it first differed from the rule of a drive."""
    settings, taps, queue, names = relay_settings(feeder), [], [], count()
    table, n = feeder.network.regulator, feeder.n_regulator
    tap, pending, armed = _initial_taps(feeder, p_kw, q_kvar)[0], np.zeros(n), np.full(n, -1)
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
                if inside and armed[i] >= 0:
                    queue, armed[i] = [action for action in queue if action[2] != armed[i]], -1
                elif pending[i] and armed[i] < 0 and abs(tap[i] + np.sign(pending[i])) <= 16:
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
                    armed[i], ended[i] = -1, second
        taps += _moved(before, tap, second)
    return taps, first_apart


def opendss_taps(feeder: ThreePhaseFeeder, p_kw: np.ndarray, q_kvar: np.ndarray) -> Taps:
    """The taps of OpenDSS's RegControls."""
    circuit, table, tap = OpenDss(feeder), feeder.network.regulator, _initial_taps(feeder, p_kw, q_kvar)[0]
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
        taps += _moved(tap, np.array(after), second)
        tap = np.array(after, float)
    return taps


def in_both(some: Taps, others: Taps) -> int:
    """Count the taps that are in both lists."""
    return sum((Counter(some) & Counter(others)).values())


def agreement(loads: Iterable[tuple[str, np.ndarray, np.ndarray]]) -> tuple[int, int, int]:
    """Taps of OpenDSS, those that the engine makes at the same second, and all that it makes."""
    asked = agreed = made = 0
    for name, p_kw, q_kvar in loads:
        theirs, (ours, _) = opendss_taps(load_feeder(name), p_kw, q_kvar), engine_taps(name, p_kw, q_kvar)
        asked, agreed, made = asked + len(theirs), agreed + in_both(ours, theirs), made + len(ours)
    return asked, agreed, made


def table() -> str:
    """The table, as Markdown."""
    heads = ["feeder", "loads", "taps of OpenDSS", "at the same second", "all taps made"]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for name in FEEDERS:
        feeder = load_feeder(name)
        cases = {"6 runs of 300 s, jumps of all loads": [(name, *moving_loads(feeder, seed)) for seed in range(6)]}
        for controller in PLAYED:
            played = zip(*played_loads(name, controller), strict=True)
            cases[f"16 episodes, {controller}"] = [(name, p_kw, q_kvar) for p_kw, q_kvar in played]
        for what, loads in cases.items():
            lines.append("| " + " | ".join([name, what, *map(str, agreement(loads))]) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(table())
