"""Observations of an agent: local fields only, unless the scenario widens the scope.

``FIELDS`` are those of the grid, one record each; those of requests of a utility are observed by sites alone. Then come
the fields of an agent's device (``Device.fields``), voltages among them in bands and without noise or delay. Two scopes
add fields at the end: `neighbours` v_deviation, p and q of the 3 electrically nearest agents, nearest first; `feeder`
v_deviation of every node but the substation's, as in node_ids.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import attrgetter
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, namespace, take_at, take_last
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.devices import Device, Field
from dcgrid_env.devices.tap_changer.regulator_view import RegulatorView, upstream_view
from dcgrid_env.engine.cost.measurement import of_agents
from dcgrid_env.engine.physics.connections import N_NEIGHBOURS, Placement, distance_in_bands
from dcgrid_env.engine.physics.node_figures import from_nodes, step_kernels
from dcgrid_env.engine.physics.parameters import inverse, parameters
from dcgrid_env.engine.physics.state import State
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.grid.random_feeders.family import RandomFeeders
from dcgrid_env.scenario.costs.load_requests import columns, sites_share
from dcgrid_env.scenario.costs.overload import loading_of_agents
from dcgrid_env.scenario.errors import ScenarioError
from dcgrid_env.scenario.grid_request import draw_range
from dcgrid_env.scenario.scenario import Scenario

_LARGEST_LOADING = 4.0
_LARGEST_RELAY = 20.0


class ObservationInputs(NamedTuple):
    """Input of the fields of the grid."""

    scenario: Scenario
    n_agents: int
    state: State
    placed: Placement
    deviation_pu: Array
    """Measured voltage of each agent less 1, p.u., (row, n_agent)."""
    change_pu: Array
    """Its change over a step."""
    phases_pu: Array
    """Lowest voltages of the agents' phases, then the highest, p.u., (row, 2 n_agent); None on a balanced feeder."""
    regulators: RegulatorView | None
    """Figures of the regulators upstream of the agents, (row, n_agent) each; None unless they are observed."""


class ObservationField(NamedTuple):
    """A figure of the grid that every agent observes."""

    name: str
    unit: str
    raw: Callable[[ObservationInputs], Array]
    """The figure before scaling, (row, n_agent)."""
    scale: Callable[[Scenario], Any]
    """Factor of it, (n_agent,) or a number."""
    bounds: Callable[[Scenario], tuple[float, float]]
    """Lowest and highest value."""
    is_observed: Callable[[Scenario], bool] = lambda _: True
    """Whether agents of a scenario observe it."""
    of_sites: bool = False
    """Whether the agents that the workload drives observe it alone."""


def _per_band(scenario: Scenario) -> float:
    return 1.0 / (scenario.cost.band_pu or 1.0)


def _band_edges(scenario: Scenario) -> tuple[float, float]:
    edge = 1.0 / scenario.cost.band_pu if scenario.cost.band_pu > 0 else 1.0
    return -edge, edge


def _per_p(scenario: Scenario) -> Array:
    return 1.0 / parameters(scenario, np.empty(0)).p_scale_kw


def _per_q(scenario: Scenario) -> Array:
    return inverse(parameters(scenario, np.empty(0)).q_scale_kvar)


def _has_phases(scenario: Scenario) -> bool:
    return isinstance(scenario.feeder, ThreePhaseFeeder)


def _sees_regulator(scenario: Scenario) -> bool:
    return scenario.sensing.regulator


def _has_requests(scenario: Scenario) -> bool:
    return bool(scenario.grid_request.targets)


def _request_field(name: str, unit: str, column: str, bounds: Callable[[Scenario], tuple[float, float]]) -> Any:
    """Return the record of a column of ``State.request``."""

    def raw(inputs: ObservationInputs) -> Array:
        return _to_all(getattr(columns(inputs.state.request), column), inputs)

    return ObservationField(name, unit, raw, lambda _: 1.0, bounds, _has_requests, of_sites=True)


def _to_all(values: Array, inputs: ObservationInputs) -> Array:
    """Return figures of an environment, (row,), for each agent, (row, n_agent)."""
    return 0.0 * inputs.state.p_kw + values[..., None]


_IN_BANDS = "(V - 1) / band, 1 is the edge of the band"
FIELDS = (
    ObservationField("v_deviation", _IN_BANDS, attrgetter("deviation_pu"), _per_band, _band_edges),
    ObservationField("v_change", "change of V over a step / band", attrgetter("change_pu"), _per_band, _band_edges),
    ObservationField(
        "p", "share of the rating, an injection negative", attrgetter("state.p_kw"), _per_p,
        lambda scenario: (-1.0, max(device.largest_draw_share for device in scenario.devices)),
    ),
    ObservationField(
        "q", "share of the reactive limit at no active power, an injection positive", attrgetter("state.q_kvar"),
        _per_q, lambda _: (-1.0, 1.0),
    ),
    ObservationField("q_limit", "the same share", attrgetter("state.q_limit_kvar"), _per_q, lambda _: (0.0, 1.0)),
    ObservationField(
        "r", "R_ii as believed: drop of the agent's voltage per MW drawn / band",
        attrgetter("placed.r"), lambda _: 1.0,
        lambda scenario: (0.0, max(_largest_distance(scenario)[0], 1e-6)),
    ),
    ObservationField(
        "x", "X_ii as believed: drop of the agent's voltage per Mvar drawn / band",
        attrgetter("placed.x"), lambda _: 1.0,
        lambda scenario: (0.0, max(_largest_distance(scenario)[1], 1e-6)),
    ),
    ObservationField(
        "v_lowest", f"{_IN_BANDS}, of the lowest phase",
        lambda inputs: inputs.phases_pu[..., : inputs.n_agents] - 1.0, _per_band,
        _band_edges, _has_phases,
    ),
    ObservationField(
        "v_highest", f"{_IN_BANDS}, of the highest phase",
        lambda inputs: inputs.phases_pu[..., inputs.n_agents :] - 1.0, _per_band,
        _band_edges, _has_phases,
    ),
    ObservationField(
        "loading", "loading of the branch that feeds the bus, of its most loaded phase; 0 where it is not known",
        lambda inputs: loading_of_agents(inputs.state, inputs.placed.nodes),
        lambda _: 1.0, lambda _: (0.0, _LARGEST_LOADING), lambda scenario: scenario.sensing.loading,
    ),
    ObservationField(
        "upstream_tap", "tap of the upstream regulator, share of its farthest tap; 0 without such a regulator",
        attrgetter("regulators.tap"), lambda _: 1.0, lambda _: (-1.0, 1.0), _sees_regulator,
    ),
    ObservationField(
        "upstream_relay", "(relay volts - target) / half band of this regulator; beyond -1 and 1 it is out of band",
        attrgetter("regulators.relay"), lambda _: 1.0, lambda _: (-_LARGEST_RELAY, _LARGEST_RELAY), _sees_regulator,
    ),
    ObservationField(
        "upstream_timer", "share of its delay that has passed, out of band or since the last tap of a sequence",
        attrgetter("regulators.timer"), lambda _: 1.0, lambda _: (0.0, 1.0), _sees_regulator,
    ),
    ObservationField(
        "request_draw", "total draw of all sites, share of the sum of their ratings",
        lambda inputs: _to_all(sites_share(inputs.scenario, inputs.state.p_kw), inputs), lambda _: 1.0, draw_range,
        _has_requests, of_sites=True,
    ),
    _request_field(
        "request_lower", "least total draw that the utility requests in the coming step, the same share", "lower_next",
        draw_range,
    ),
    _request_field("request_upper", "most total draw, the same share", "upper_next", draw_range),
    _request_field(
        "request_left", "time until this request ends, share of the notice, 1 at most; 0 without one", "left",
        lambda _: (0.0, 1.0),
    ),
    _request_field(
        "request_wait", "time until the next request starts, share of the notice; 1 if none is announced", "wait",
        lambda _: (0.0, 1.0),
    ),
    _request_field(
        "coming_lower", "least total draw of that request, share of the ratings", "lower_announced",
        draw_range,
    ),
    _request_field(
        "coming_upper", "most total draw of that request, share of the ratings", "upper_announced",
        draw_range,
    ),
)  # fmt: skip
"""Fields of the grid, in order."""


@cached_on_owner
def grid_fields(scenario: Scenario) -> tuple[ObservationField, ...]:
    """The fields of the grid that agents of a scenario observe."""
    return tuple(field for field in FIELDS if field.is_observed(scenario))


def field_names(scenario: Scenario) -> dict[str, tuple[str, ...]]:
    """Names of the observed fields, in order, for each agent."""
    wider: tuple[str, ...] = ()
    if scenario.sensing.observe == "neighbours":
        count = min(N_NEIGHBOURS, scenario.n_agents - 1)
        wider = tuple(f"neighbour{i}_{name}" for i in range(count) for name in ("v_deviation", "p", "q"))
    elif scenario.sensing.observe == "feeder":
        wider = tuple(f"v_deviation_{node}" for node in scenario.feeder.node_ids[scenario.feeder.load_slice])
    agents = iter(scenario.agents)
    return {
        next(agents): (*_of_grid(scenario, device), *(field.name for field in fields), *wider)
        for device, fields in zip(scenario.devices, device_fields(scenario), strict=True)
        for _ in range(device.count)
    }


def _of_grid(scenario: Scenario, device: Device) -> tuple[str, ...]:
    """Names of the fields of the grid that agents of a device observe, in order."""
    return tuple(field.name for field in grid_fields(scenario) if _observes(device, field))


def _observes(device: Device, field: ObservationField) -> bool:
    return device.input == "workload" or not field.of_sites


@cached_on_owner
def device_fields(scenario: Scenario) -> tuple[tuple[Field, ...], ...]:
    """The fields of each device, those that are deviations of voltages in bands.

    ScenarioError for a field, or a cost term, with the name of a field of the grid.
    """
    band, of_grid = scenario.cost.band_pu or 1.0, {field.name for field in FIELDS}
    lengths = scenario.horizon, scenario.dt_s
    of_devices = [device.fields(*lengths) for device in scenario.devices]
    for device, fields in zip(scenario.devices, of_devices, strict=True):
        for name in (*(field.name for field in fields), *(term.name for term in device.cost_terms(*lengths))):
            if name in of_grid:
                raise ScenarioError(f"{device.kind!r} calls something {name!r}, which is the grid's; rename it")
    return tuple(
        tuple(_in_bands(field, band) if field.of_band else field for field in one_device) for one_device in of_devices
    )


def _in_bands(field: Field, band_pu: float) -> Field:
    return field._replace(
        lowest=field.lowest / band_pu, highest=field.highest / band_pu, share_of=field.share_of * band_pu
    )


def bounds(scenario: Scenario) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Lowest and highest value of each field, float32, for each agent."""
    range_of = {field.name: field.bounds(scenario) for field in grid_fields(scenario)}

    def find(name: str, fields: dict[str, tuple[float, float]]) -> tuple[float, float]:
        if name in fields:
            return fields[name]
        if name.startswith("neighbour"):
            name = name.partition("_")[2]
        return range_of["v_deviation" if name.startswith("v_deviation") else name]

    of_device = [
        {field.name: (field.lowest, field.highest) for field in fields}
        for device, fields in zip(scenario.devices, device_fields(scenario), strict=True)
        for _ in range(device.count)
    ]
    ranges = {
        agent: np.array([find(name, fields) for name in names])
        for (agent, names), fields in zip(field_names(scenario).items(), of_device, strict=True)
    }
    return {a: (b[:, 0].astype(np.float32), b[:, 1].astype(np.float32)) for a, b in ranges.items()}


@cached_on_owner
def joint_bounds(scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the joint observation, the agents' one after the other, float32, (n_observation,) each."""
    low, high = zip(*bounds(scenario).values(), strict=True)
    return np.concatenate(low), np.concatenate(high)


def _largest_distance(scenario: Scenario) -> tuple[float, float]:
    """Largest R_ii and X_ii of any agent at any bus, in bands; on random feeders what they are below on all of them."""
    feeder, band = scenario.family.feeder, scenario.cost.band_pu or 1.0
    if isinstance(feeder, RandomFeeders):
        largest = feeder.largest_drop_pu_per_mw / band
        return largest * scenario.sensing.r_model_share, largest * scenario.sensing.x_model_share
    distances = distance_in_bands(scenario)
    return float(distances[..., 0].max()), float(distances[..., 1].max())


class Layout(NamedTuple):
    """How raw figures become the joint observation."""

    raw: tuple[Callable[[ObservationInputs], Array], ...]
    """Functions of the fields of the grid."""
    scale: Array
    """Factor of each raw figure, (n_raw,)."""
    column: Array
    """Raw figure behind each entry of the joint observation, (n_observation,)."""


@cached_on_owner
def _layout(scenario: Scenario, xp: ModuleType, dtype: object, device_of: object) -> Layout:
    """How the raw figures, in the order in which ``observe`` joins them, become the joint observation."""
    n = scenario.n_agents
    near = min(N_NEIGHBOURS, n - 1) if scenario.sensing.observe == "neighbours" else 0
    of_grid = grid_fields(scenario)
    blocks = [field.scale(scenario) * np.ones(n) for field in of_grid]
    common = len(blocks)
    for fields in device_fields(scenario):
        blocks += [1.0 / f.share_of * (scenario.sensing.preview if f.of_preview else True) for f in fields]
    starts = np.cumsum([0, *map(len, blocks)]).tolist()
    scale = np.concatenate(blocks)
    column, agent, block = [], 0, common
    for device, fields in zip(scenario.devices, device_fields(scenario), strict=True):
        for slot in range(device.count):
            column += [starts[k] + agent for k in range(common) if _observes(device, of_grid[k])]
            column += [starts[block + k] + slot for k in range(len(fields))]
            if scenario.sensing.observe == "neighbours":
                column += range(len(scale) + 3 * near * agent, len(scale) + 3 * near * (agent + 1))
            elif scenario.sensing.observe == "feeder":
                column += range(len(scale), len(scale) + len(scenario.feeder.load_nodes))
            agent += 1
        block += len(fields)
    if scenario.sensing.observe == "neighbours":
        scale = np.concatenate((scale, np.ones(3 * near * n)))
    elif scenario.sensing.observe == "feeder":
        scale = np.concatenate((scale, np.full(len(scenario.feeder.load_nodes), _per_band(scenario))))
    return Layout(
        tuple(field.raw for field in of_grid),
        xp.asarray(scale, dtype=dtype, device=device_of),
        xp.asarray(np.array(column, dtype=np.int64), device=device_of),
    )


def observe(
    scenario: Scenario,
    state: State,
    placed: Placement,
    given_next: Sequence[Any],
    v_measured_pu: Array,
    v_before_pu: Array,
) -> Array:
    """The joint observation, (row, n_observation), in the precision of the state and not yet cut to its bounds.

    Parameters
    ----------
    scenario, state
        Scenario and state after the last step.
    placed
        The episode's placement.
    given_next
        What comes from outside over the coming interval, for each device (``episode.given_next``).
    v_measured_pu, v_before_pu
        Voltage as measured now and one step before, p.u. (``measurement.measure``); the state's own unless the
        scenario has noise or delay.
    """
    raw, layout = _raw(scenario, state, placed, given_next, v_measured_pu, v_before_pu)
    return take_last(raw * layout.scale, layout.column)


def observe_within_bounds(scenario: Scenario, *observed: Array) -> np.ndarray:
    """What ``observe`` gives of NumPy arrays, as float32 and cut to its bounds."""
    raw, layout = _raw(scenario, *observed)
    return step_kernels().joint_observation(raw, layout.scale, layout.column, *joint_bounds(scenario))


def _raw(
    scenario: Scenario,
    state: State,
    placed: Placement,
    given_next: Sequence[Any],
    v_measured_pu: Array,
    v_before_pu: Array,
) -> tuple[Array, Layout]:
    """The raw figures, (row, n_raw), and how they become the joint observation."""
    xp = namespace(state.v_pu)
    layout, params = _layout(scenario, xp, state.v_pu.dtype, state.v_pu.device), parameters(scenario, state.v_pu)
    v_now, phases = of_agents(scenario, v_measured_pu, placed.nodes)
    v_before, _ = of_agents(scenario, v_before_pu, placed.nodes)
    regulators = None
    if state.regulator_views is not None:
        by_node = upstream_view(scenario.feeder, state.regulator_views[0])  # pyright: ignore[reportArgumentType]
        regulators = RegulatorView(*(from_nodes(figures, placed.nodes) for figures in by_node))
    inputs = ObservationInputs(
        scenario, scenario.n_agents, state, placed, v_now - 1.0, v_now - v_before, phases, regulators
    )
    raw = [of_field(inputs) for of_field in layout.raw]
    for i, its_state in enumerate(state.devices):
        if its_state:
            raw += scenario.devices[i].observe(params.devices[i], its_state, given_next[i])
    if scenario.sensing.observe == "neighbours":
        trio = (
            inputs.deviation_pu * _per_band(scenario),
            state.p_kw / params.p_scale_kw,
            state.q_kvar * params.per_q_scale,
        )
        near = (take_at(field, placed.nearest)[..., None] for field in trio)
        raw.append(xp.concat(tuple(near), axis=-1).reshape(v_now.shape[0], -1))
    elif scenario.sensing.observe == "feeder":
        raw.append(v_measured_pu[:, scenario.feeder.load_slice] - 1.0)
    return xp.concat(raw, axis=-1), layout
