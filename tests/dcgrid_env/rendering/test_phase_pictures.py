"""The picture of a three-phase feeder shows the state, phase by phase."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.text import Text

import dcgrid_env
from dcgrid_env import Fault
from dcgrid_env.powerflow import three_phase_nodes
from dcgrid_env.rendering.bus_positions import positions
from dcgrid_env.rendering.equipment_labels import signed
from dcgrid_env.rendering.phase_map import NO_VOLTAGE, PhaseMap
from helpers.feeders import THREE_PHASE
from helpers.forms import variant_of
from helpers.three_phase import one_phase

QUICK = "ieee13-3ph"
each = pytest.mark.parametrize(
    "name", [QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in THREE_PHASE if name != QUICK)]
)
"""On each three-phase feeder, but the smallest among the slow tests."""


def make(scenario: Any = "ieee13-3ph", steps: int = 0, **overrides: Any) -> tuple[Any, list[Any]]:
    env: Any = dcgrid_env.DcgridEnv(scenario, render_mode="rgb_array", **overrides)
    env.reset(seed=0)
    rng = np.random.default_rng(1)
    states = [env.transition.state]
    for _ in range(steps):
        env.step(rng.uniform(-1, 1, env.action_space.shape))
        states.append(env.transition.state)
    env.render()
    return env, states


def parts(env):
    return env._viewer._parts


def labels(env):
    return [label.get_text() for label in parts(env)[0].equipment.labels]


def is_image(frame):
    return frame.shape == (800, 1360, 3) and frame.std() > 5.0


@each
@pytest.mark.slow
def test_each_bus_shows_the_voltages_of_its_phases_in_their_places(name):
    env, states = make(name, 5)
    feeder, v, xy = env.scenario.feeder, states[-1].v_pu[0], positions(env.scenario.feeder)
    drawn = parts(env)[0].feeder
    for phase, sector in enumerate(drawn.sectors):
        nodes = np.flatnonzero(feeder.node_phase == phase + 1)
        np.testing.assert_allclose(sector.get_array(), v[nodes], rtol=1e-6)
        np.testing.assert_array_equal(sector.get_offsets(), xy[feeder.node_bus[nodes]])
        middle = sector.get_paths()[0].vertices.mean(axis=0)
        assert np.sign(np.round(middle, 2)).tolist() == [[0, 1], [1, -1], [-1, -1]][phase]
    lacks = [len(phases) < 3 for phases in feeder.bus_phases]
    np.testing.assert_array_equal(drawn.circles.get_offsets(), xy[lacks])


def test_a_sector_outside_the_band_has_a_rim_and_one_without_voltage_its_own_colour():
    feeder = dcgrid_env.load_feeder("ieee13-3ph")
    figure = Figure((7, 5))
    FigureCanvasAgg(figure)
    drawn = PhaseMap(figure.add_axes((0.0, 0.0, 1.0, 1.0)), feeder, positions(feeder), 0.05, ((), ()))
    drawn.place([], [])
    v = np.ones(feeder.n_node)
    low, high = feeder.nodes_of("611", "c")[0], feeder.nodes_of("675", "b")[0]
    v[low], v[high], v[0] = 0.94, 1.06, np.nan
    drawn.update(v)
    drawn.mark_worst(None)
    figure.canvas.draw()
    assert [rim.get_visible() for rim in drawn.rims] == [False, True, True]
    np.testing.assert_array_equal(drawn.rims[1].get_offsets(), drawn.xy[[feeder.index("675")]])
    np.testing.assert_array_equal(drawn.rims[2].get_offsets(), drawn.xy[[feeder.index("611")]])
    colour: Any = drawn.sectors[0].get_facecolor()
    assert to_hex(colour[0]).upper() == NO_VOLTAGE
    assert not drawn.worst.get_visible()


@pytest.mark.slow
def test_the_bus_of_the_largest_unbalance_is_ringed_and_named():
    env, states = make("ieee123-3ph", 8)
    feeder, factor = env.scenario.feeder, states[-1].three_phase.unbalance[0]
    bus = feeder.node_bus[three_phase_nodes(feeder)[factor.argmax(), 0]]
    panel = parts(env)[0]
    np.testing.assert_array_equal(panel.feeder.worst.get_offsets(), panel.feeder.xy[[bus]])
    assert f"largest unbalance {100 * factor.max():.2f} % at bus {feeder.bus_ids[bus]};" in panel.more.get_text()


@pytest.mark.slow
def test_taps_and_banks_are_said_where_they_are():
    env, states = make("ieee13-3ph", 12, grid_control={"regulators": "agent", "capacitors": "agent"})
    regulators, banks = states[-1].three_phase.equipment
    a, b, c = (signed(tap) for tap in regulators.tap[0])
    on = ["on" if state > 0.5 else "off" for state in banks.on[0]]
    assert labels(env) == [f"reg1 a{a} b{b} c{c}\nreg_0 reg_1 reg_2", f"cap1 {on[0]}\ncap_0", f"cap2 {on[1]}\ncap_1"]
    panel = parts(env)[0]
    places = [panel.feeder.xy[env.scenario.feeder.index(bus)].tolist() for bus in ("rg60", "675", "611")]
    assert [list(label.xy) for label in panel.equipment.labels] == places
    moved = int(regulators.moves.sum()), int(banks.switchings.sum())
    assert min(moved) > 0
    assert f"taps moved: {moved[0]};   capacitors switched: {moved[1]}" in panel.more.get_text()


def test_taps_have_signs():
    assert [signed(tap) for tap in (-3.0, 0.0, 11.0)] == ["\N{MINUS SIGN}3", "0", "+11"]


@pytest.mark.slow
def test_a_lost_bank_and_banks_switched_off_are_said():
    fault = Fault(among=("capacitor",), begin_s=(2.0, 2.0), duration_s=(2.0, 2.0))
    env, _ = make("ieee13-3ph", 2, faults=(fault,))
    assert sorted(text.split()[-1] for text in labels(env)[1:]) == ["on", "on"]
    env.step(np.zeros(env.action_space.shape))
    env.render()
    assert sorted(text.split()[-1] for text in labels(env)[1:]) == ["lost", "on"]
    assert labels(make("ieee13-3ph", background={"capacitors": False})[0])[1:] == ["cap1 off", "cap2 off"]


@each
@pytest.mark.slow
def test_curves_are_each_phase_s_spread_the_unbalance_and_the_taps(name):
    env, states = make(name, 25)
    feeder, curves = env.scenario.feeder, parts(env)[1]
    v = np.array([state.v_pu[0] for state in states])
    t = np.arange(26.0)
    for k, (phase, spread) in enumerate(zip("abc", curves.voltages, strict=True)):
        nodes = feeder.load_nodes[feeder.node_phase[feeder.load_nodes] == k + 1]
        own = v[:, nodes]
        np.testing.assert_allclose(spread.mean.get_ydata(), own.mean(axis=1), rtol=1e-6)
        outline = spread.range.get_paths()[0].vertices[:52]
        np.testing.assert_allclose(outline[:26], np.column_stack((t, own.min(axis=1))), rtol=1e-6)
        np.testing.assert_allclose(outline[26:], np.column_stack((t, own.max(axis=1)))[::-1], rtol=1e-6)
        assert curves.heads[k].get_ylabel() == f"voltage {phase}\n(p.u.)"
    factor = 100.0 * np.array([state.three_phase.unbalance[0] for state in states])
    np.testing.assert_allclose(curves.largest.get_ydata(), factor.max(axis=1), rtol=1e-5)
    np.testing.assert_allclose(curves.mean_unbalance.get_ydata(), factor.mean(axis=1), rtol=1e-5)
    taps = np.array([state.three_phase.equipment.regulators.tap[0] for state in states])
    drawn = [path.vertices[::2, 1] for path in curves.taps.lines[0].get_paths()]
    np.testing.assert_array_equal(drawn, taps.T)
    low, high = curves.taps_axes.get_ylim()
    assert low < taps.min() <= taps.max() < high


@pytest.mark.slow
def test_an_agent_s_voltage_stands_in_the_axes_of_its_phases():
    env, states = make("ieee13-3ph", 4)
    feeder, curves = env.scenario.feeder, parts(env)[1]
    for name, bundle in curves.by_phase.items():
        sites, inverters = (lines.get_segments() for lines in bundle.lines)
        node = feeder.nodes_of("671", name)[0]
        np.testing.assert_allclose(sites[0][:, 1], [state.v_pu[0, node] for state in states], rtol=1e-6)
        one = inverters[2]  # at bus 611, which has phase c alone
        assert bool(len(one) and np.isfinite(one[:, 1]).all()) == (name == "c")


@pytest.mark.parametrize(
    ("scenario", "overrides"),
    [
        ("ieee34-3ph", {"grid_control.regulators": "agent", "grid_control.capacitors": "agent"}),
        pytest.param("ieee123-3ph", {"grid_control.regulators": "agent"}, marks=pytest.mark.slow),
    ],
)
@pytest.mark.slow
def test_a_part_drawn_anew_is_what_a_whole_picture_has_there(scenario, overrides):
    (env, _), (fresh, _) = make(scenario, **overrides), make(scenario, **overrides)
    fresh.close()
    fresh.reset(seed=0)
    rng = np.random.default_rng(1)
    for _ in range(12):
        action = rng.uniform(-1, 1, env.action_space.shape)
        env.step(action)
        fresh.step(action)
        env.render()
    assert "taps moved: 0" not in parts(env)[0].more.get_text()
    np.testing.assert_array_equal(env.render(), fresh.render())


@pytest.mark.slow
def test_a_frame_in_which_no_tap_moves_lays_out_no_text(monkeypatch):
    env, _ = make("ieee123-3ph", grid_control={"regulators": "fixed"})
    drawn = []
    for kind in (Text, Axes):
        plain = kind.draw
        monkeypatch.setattr(kind, "draw", lambda self, *a, plain=plain, **k: (drawn.append(self), plain(self, *a, **k)))
    for _ in range(3):
        env.step(np.zeros(env.action_space.shape))
        env.render()
    assert not drawn
    assert not parts(env)[1].has_taps  # regulators that are fixed take no axes


@pytest.mark.slow
def test_a_collapse_is_drawn_with_the_last_solved_voltages():
    env, _ = make("ieee13-3ph", datacenters={"p_rated_kw": 8000.0}, split="test")
    while not env.transition.terminated[0]:
        env.step(np.zeros(env.action_space.shape))
    assert is_image(env.render())
    panel = parts(env)[0]
    assert "voltage collapse" in panel.subtitle.get_text()
    assert all(np.isfinite(sector.get_array()).all() for sector in panel.feeder.sectors)


def test_a_feeder_of_one_phase_has_no_unbalance_to_show():
    env, states = make(one_phase(), 3)
    panel, curves = parts(env)
    assert panel.more.get_text() == "no three-phase bus"
    assert not panel.feeder.worst.get_visible()
    assert [ax.get_ylabel() for ax in curves.heads] == ["voltage b\n(p.u.)"]
    assert [len(sector.get_offsets()) for sector in panel.feeder.sectors] == [1, 3, 1]  # the source has all phases
    np.testing.assert_allclose(panel.feeder.sectors[1].get_array(), states[-1].v_pu[0, [1, 3, 4]], rtol=1e-6)


@pytest.mark.slow
def test_without_sites_and_in_a_batch():
    env, _ = make("ieee13-3ph", 2, n_datacenters=0, datacenters={"buses": ()})
    assert is_image(env.render())
    batch: Any = dcgrid_env.DcgridVectorEnv(
        2, "ieee13-3ph", render_mode="rgb_array", grid_control={"regulators": "agent"}
    )
    batch.reset(seed=[0, 1])
    batch.step(np.random.default_rng(0).uniform(-1, 1, batch.action_space.shape))
    first, second = batch.render()
    assert (first != second).any()
    np.testing.assert_array_equal(batch.render()[0], first)


@pytest.mark.parametrize(
    ("name", "who"),
    [
        pytest.param(name, who, marks=pytest.mark.slow if who == "controlled" and name != QUICK else ())
        for name in THREE_PHASE
        for who in ("controlled", "agent")
    ],
)
@pytest.mark.slow
def test_names_and_labels_keep_off_each_other_and_in_the_frame(name, who):
    env, _ = make(name, grid_control={"regulators": who}, split="test")
    panel = parts(env)[0]
    env._viewer._figure.canvas.draw()
    renderer = env._viewer._figure.canvas.get_renderer()
    frame = panel.feeder.ax.get_window_extent()
    items = [
        (text.get_text(), Text.get_window_extent(text, renderer))
        for text in panel.feeder.ax.texts
        if text.get_visible()
    ]
    for k, (text, box) in enumerate(items):
        assert frame.x0 <= box.x0 and box.x1 <= frame.x1 and frame.y0 <= box.y0 and box.y1 <= frame.y1, text  # noqa: PT018
        for other, taken in items[:k]:
            assert not box.shrunk(0.9, 0.7).overlaps(taken.shrunk(0.9, 0.7)), (text, other)


@each
@pytest.mark.slow
def test_keys_stay_in_the_figure_and_names_of_axes_off_each_other(name):
    env, _ = make(name, grid_control={"regulators": "agent", "capacitors": "agent"})
    figure = env._viewer._figure
    figure.canvas.draw()
    for legend in figure.legends:
        box = legend.get_window_extent()
        assert box.x0 >= 0 and box.x1 <= 1360 and box.y0 >= 0 and box.y1 <= 800  # noqa: PT018
    keys = [legend.get_window_extent() for legend in figure.legends]
    assert not any(a.overlaps(b) for i, a in enumerate(keys) for b in keys[:i])
    names = [ax.yaxis.label.get_window_extent() for ax in parts(env)[1].axes]
    assert all(upper.y0 >= lower.y1 for upper, lower in pairwise(names))


@pytest.mark.slow
def test_labels_name_the_agents_of_set_points():
    env, _ = make(variant_of("set points as agents"))
    assert [text.split("\n")[1:] for text in labels(env)] == [["regset_0"], ["capset_0"], ["capset_1"]]
