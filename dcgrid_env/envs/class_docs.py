"""Shared parts of the environment classes' docstrings: problem, spaces, reward, start, end and ``info``.

``documented`` fills the places that the docstring of a class has for these parts. The cost terms and the observation
fields of the grid come from their records; tests compare the rest with the code.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Sequence
from itertools import zip_longest
from textwrap import wrap
from typing import TypeVar

from dcgrid_env.engine.cost import observation
from dcgrid_env.scenario.costs.grid_terms import TERMS

Class = TypeVar("Class", bound=type)

CHANNELS = (
    ("clock", "data centre", "lowest to highest GPU clock, held over the step"),
    ("q", "data centre, inverter", "share of the reactive limit at zero active power; an injection is positive"),
)
"""Channels of the usual devices: name, devices and meaning of -1 to 1."""
RANGES = {
    "v_deviation": ("all", "-1/band .. 1/band"),
    "v_change": ("all", "-1/band .. 1/band"),
    "p": ("all", "-1 .. boost_share"),
    "q": ("all", "-1 .. 1"),
    "q_limit": ("all", "0 .. 1"),
    "r": ("all", "0 .. largest"),
    "x": ("all", "0 .. largest"),
    "v_lowest": ("all (a)", "-1/band .. 1/band"),
    "v_highest": ("all (a)", "-1/band .. 1/band"),
    "loading": ("all (b)", "0 .. 4"),
    "upstream_tap": ("all (c)", "-1 .. 1"),
    "upstream_relay": ("all (c)", "-20 .. 20"),
    "upstream_timer": ("all (c)", "0 .. 1"),
    "request_draw": ("sites (d)", "0 .. boost_share"),
    "request_lower": ("sites (d)", "0 .. boost_share"),
    "request_upper": ("sites (d)", "0 .. boost_share"),
    "request_left": ("sites (d)", "0 .. 1"),
    "request_wait": ("sites (d)", "0 .. 1"),
    "coming_lower": ("sites (d)", "0 .. boost_share"),
    "coming_upper": ("sites (d)", "0 .. boost_share"),
}
"""Agents that observe each field of the grid, and its range."""
FIELDS = (
    *((field.name, *RANGES[field.name], field.unit) for field in observation.FIELDS),
    ("p_ref_next", "data centre", "0 .. boost_share", "draw in the coming step at the top clock, share of the rating"),
    ("backlog", "data centre", "0 .. horizon dt_s", "queued work, s at the rating"),
)
"""Observation fields of the usual agents in their order: name, agents, range and meaning."""
FEATURES = (
    ("three-phase feeder", "", "v_lowest, v_highest", "unbalance, switching"),
    ("sensing.loading", "", "loading", ""),
    ("sensing.regulator", "", "upstream_tap, upstream_relay, upstream_timer", ""),
    (
        "grid_request",
        "",
        "request_draw, request_lower, request_upper, request_left, request_wait, coming_lower, coming_upper",
        "",
    ),
    ("clock_law of two classes", "", "p_ref_next_compute, backlog_compute", ""),
    (
        "ride_through (data centre)",
        "return",
        "ups_share, ups_locked, ups_events, ups_returns, ups_timer, ups_wait, ups_stored",
        "trips, away, recharge",
    ),
    ("ride_through (inverter)", "", "connected, trip_timer, return_wait", "inverter_trips"),
    (
        "smoothing",
        "floor, ramp_up, ramp_down",
        "smoothed, floor_held, quiet, floor_set, ramp_up_set, ramp_down_set, settings_held",
        "burnt",
    ),
    ("cooling", "", "cooling", ""),
    ("routing", "route", "work_share, work_next_all", "moving"),
    ("batching", "batch", "batch", "gathering"),
    ("service", "", "overdue, due_next", "late"),
    ("storage (data centre)", "storage_p", "stored, charge_limit, discharge_limit", "site_ageing, site_missing"),
    ("device storage", "p, q", "stored, charge_limit, discharge_limit", "ageing, missing"),
    ("device tap_changer", "tap", "tap, since_tap, relay", ""),
    ("device capacitor_bank", "on", "on, since_switching", ""),
    ("device regulator_setpoint", "offset, half_band", "mean_tap, offset, half_band, since_change, mean_relay", ""),
    ("device capacitor_setpoint", "centre, half_width", "on, centre, half_width, since_change, bank_voltage", ""),
)
"""Additions of features and further devices: channels, observation fields and cost terms."""
COSTS = tuple((term.name, f"{term.weight:g}", re.sub(r"\|(.+?)\|", r"abs(\1)", term.meaning)) for term in TERMS)
"""Cost terms: name, default weight and meaning; bars would be markup of reStructuredText."""
OF_STEP = " (s)"
"""Mark of the keys that belong to a step, for which a reset has no figures."""
INFO = (
    ("cost_TERM", "cost term of the step, as charged" + OF_STEP),
    ("cost", "constraint for constrained learning: violation, excesses over limits and trips" + OF_STEP),
    ("reward_vector", "difference reward of each channel (reward='difference')" + OF_STEP),
    ("J", "cost since the reset / horizon; the cost of the episode after its last step" + OF_STEP),
    ("power_flow_converged", "1, or 0 if the power flow has no solution"),
    ("voltage_min_pu, voltage_max_pu", "lowest and highest voltage, p.u."),
    ("backlog_kws", "queued work of all data centres, kW s"),
    ("loss_kw", "loss of the feeder, kW"),
    ("unbalance_max_pct", "largest voltage unbalance factor (three-phase feeders)"),
    ("tap_moves, capacitor_switchings", "moves in the step (three-phase feeders)" + OF_STEP),
    ("tap_NAME, capacitor_NAME", "position of each regulator and capacitor bank (three-phase feeders)"),
    ("grid_request_lower_kw", "least total draw of the sites that is requested, kW (grid_request)"),
    ("grid_request_upper_kw", "most total draw of the sites that is requested, kW (grid_request)"),
    ("grid_request_missed_kw", "distance of that draw from it, kW (grid_request)"),
)
"""Keys of ``info`` and their meaning; features and further devices add theirs."""


def table(header: Sequence[str], rows: Iterable[Sequence[str]], widest: Sequence[int]) -> str:
    """Return a simple table of reStructuredText, with cells wrapped to the widest of their columns."""
    wrapped = [[_wrapped(*cell) for cell in zip(row, widest, strict=True)] for row in (header, *rows)]
    widths = [max(len(line) for row in wrapped for line in row[i]) for i in range(len(header))]
    lines = [list(zip_longest(*row, fillvalue="")) for row in wrapped]
    rule = "  ".join("=" * width for width in widths)
    shown = ["\n".join("  ".join(map(str.ljust, line, widths)).rstrip() for line in row) for row in lines]
    return "\n".join([rule, shown[0], rule, *shown[1:], rule])


def _wrapped(cell: str, width: int) -> list[str]:
    return wrap(cell, width, break_on_hyphens=False)


PARTS = {
    "training": """\
An action of 0 is a clock half-way between the lowest and the highest, and no
reactive power, so that an untrained policy throttles every site. With this form and
one reward for all agents, PPO with its default settings stays far below the droop
law. For training start from ``dcgrid_env.agents.sb3_vec_env``, or for other libraries
``training_env``, whose untrained policy is no control (docs/first-training.md).""",
    "problem": """\
Data centres and inverters are connected to a distribution feeder. The load of the
data centres changes within seconds, and the voltages of the feeder follow it. Each
device is an agent: a data centre sets the clock of its GPUs and its reactive power,
an inverter sets its reactive power. The aim is to keep every voltage near 1 p.u. and
within a band (0.95 to 1.05 p.u. by default), with little delay of the data centres'
work. A lower clock draws less power, and the work that is not served waits in a
queue.

A scenario defines feeder, devices, load, sensing and cost. ``dcgrid list scenarios``
lists the presets. An episode has ``horizon`` steps of ``dt_s`` seconds. Each step
solves the power flow: DistFlow on a balanced feeder, a sweep on a three-phase feeder.""",
    "actions": f"""\
Each agent has the channels of its device, in this order.
``action_layout(scenario).names`` lists all.

{table(("channel", "device", "meaning of -1 to 1"), CHANNELS, (7, 21, 54))}

Reactive power is limited to min(q_max, sqrt(s_rated^2 - p^2)) at the active power p.
Values outside of [-1, 1] are cut to it. ``ActionError`` is raised for a value that is
not finite.""",
    "observations": f"""\
Each agent observes its own fields, in this order. ``field_names(scenario)`` lists
all. The band is ``cost.band_pu``, 0.05 p.u. by default, and R and X are those that
agents believe (``sensing.r_model_share``, ``sensing.x_model_share``).

{table(("field", "agents", "range", "meaning"), FIELDS, (14, 11, 18, 42))}

(a) on a three-phase feeder, (b) with ``sensing.loading``, (c) with ``sensing.regulator``,
(d) data centres with ``grid_request``.

``observe="neighbours"`` adds v_deviation, p and q of the three electrically nearest
agents. ``observe="feeder"`` adds v_deviation of every bus.
``sensing={{"preview": False}}`` sets p_ref_next to 0. ``sensing.noise_pu`` and
``sensing.delay_steps`` add noise and delay to measured voltages.

Features of the scenario and further devices add channels, fields and cost terms:

{table(("feature", "channels", "fields", "cost terms"), FEATURES, (26, 10, 30, 14))}""",
    "reward": f"""\
The reward of a step is minus its cost, the sum of these terms times their weights.
``weights={{"step": 1.0}}`` changes a weight.

{table(("term", "weight", "charges"), COSTS, (19, 7, 54))}

``cost.voltage`` replaces abs(V - 1) by another function of it, and
``cost.reference="profile"`` 1 p.u. by the utility's voltages. J, the cost of an
episode, is the sum of all terms over its steps, divided by ``horizon``.""",
    "start": """\
``reset(seed=n)`` begins the first episode of seed n, which is the same in all
environment classes. ``reset()`` begins the next episode. An episode draws the windows
of the load traces and the noise of the other loads. Where the scenario leaves them
open it also draws the buses of the data centres, the time of day, faults and sags.

At t = 0 the data centres have their top clock and an empty queue, no device injects
reactive power, and controlled regulators have settled. This state is observed and not
charged.""",
    "end": """\
An episode is truncated after ``horizon`` steps. It is terminated if the power flow
has no solution; each step that remains is then charged at the largest cost that a
step can have.""",
    "info": f"""\
``info="full"`` has these keys, ``info="costs"`` the first four, ``info="none"``
none. Keys with (s) and counts of trips belong to a step. A reset has no figures for
them.

{table(("key", "meaning"), INFO, (31, 54))}

``METRICS`` lists the metrics of a whole episode, and ``Recorder`` computes them.""",
}
"""Parts by their places in the docstrings."""


def documented(environment: Class) -> Class:
    """Fill the places in a class's docstring, ``{problem}`` and so on, with the parts."""
    if environment.__doc__ is not None:  # Python has none with -OO
        text = inspect.cleandoc(environment.__doc__)
        for name, part in PARTS.items():
            text = text.replace(f"{{{name}}}", part)
        environment.__doc__ = text
    return environment
