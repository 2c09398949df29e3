"""The picture of an episode: shape, what it follows, and that it leaves nothing behind."""

import copy
import itertools
import logging
import pickle
import sys
from types import ModuleType
from typing import Any

import gymnasium
import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

import dcgrid_env
from dcgrid_env.rendering.viewer import SIZE_PX, Viewer

SHAPE = (SIZE_PX[1], SIZE_PX[0], 3)


@pytest.fixture(autouse=True)
def agg():
    backend = matplotlib.get_backend()
    matplotlib.use("agg")
    yield
    pyplot.close("all")
    matplotlib.use(backend)


def make(scenario="toy6", render_mode="rgb_array", **overrides):
    env = dcgrid_env.DcgridEnv(scenario, render_mode=render_mode, **overrides)
    env.reset(seed=0)
    return env


def run(env, steps, seed=1):
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        env.step(rng.uniform(-1, 1, env.action_space.shape))


def titles(env):
    """Title and line below."""
    parts = env._viewer._parts
    return parts[0].title.get_text(), parts[0].subtitle.get_text()


def curve(env, name, agent=0):
    """Times and values as drawn: (step, 2), without the corners of steps."""
    bundle, n_dc = env._viewer._parts[1].curves[name], env.scenario.datacenters.count
    lines = bundle.lines[0] if agent < n_dc else bundle.lines[1]
    path = lines.get_paths()[agent if agent < n_dc else agent - n_dc].vertices
    return path[::2] if bundle.steps else path


def is_image(frame):
    return frame.shape == SHAPE and frame.dtype == np.uint8 and frame.std() > 5.0


@pytest.mark.slow
def test_frames_have_one_size_and_follow_the_episode():
    env = make()
    frames = [env.render()]
    for _ in range(2):
        run(env, 12)
        frames.append(env.render())
    assert all(is_image(frame) for frame in frames)
    for before, after in itertools.pairwise(frames):
        assert (before != after).any(axis=2).mean() > 1e-3
    np.testing.assert_array_equal(env.render(), frames[-1])


def test_frames_do_not_share_memory():
    env = make()
    first = env.render()
    kept = first.copy()
    run(env, 20)
    env.render()
    np.testing.assert_array_equal(first, kept)


@pytest.mark.slow
def test_the_kept_background_changes_nothing():
    """A frame drawn after others is the frame that a viewer which draws for the first time would make."""
    env, fresh = make("ieee123", horizon=20), make("ieee123", horizon=20)
    run(env, 20)
    run(fresh, 20)
    env.render()
    env.reset()
    fresh.reset()
    env.render()
    run(env, 7)
    run(fresh, 7)
    np.testing.assert_array_equal(env.render(), fresh.render())


@pytest.mark.parametrize(
    "scenario", ["toy6", *(pytest.param(name, marks=pytest.mark.slow) for name in ("ieee123", "training"))]
)
@pytest.mark.slow
def test_a_part_drawn_anew_is_what_a_whole_picture_has_there(scenario):
    """Axes that grow and names that move, one at a time, against a picture that is drawn for the first time."""
    env, fresh = make(scenario, horizon=60), make(scenario, horizon=60)
    slowest = np.full_like(env.action_space.sample(), -1.0)
    for _ in range(60):
        env.step(slowest)
        fresh.step(slowest)
        env.render()
    np.testing.assert_array_equal(env.render(), fresh.render())
    env.reset(seed=1)
    fresh = make(scenario, horizon=60)
    fresh.reset(seed=1)
    np.testing.assert_array_equal(env.render(), fresh.render())


@pytest.mark.slow
def test_a_usual_frame_lays_out_no_text_and_only_what_changed_is_drawn_anew(monkeypatch):
    env = make("toy6", datacenters={"p_rated_kw": 2500.0})
    env.render()
    drawn = []
    for kind in (Text, Axes):
        plain = kind.draw
        monkeypatch.setattr(kind, "draw", lambda self, *a, plain=plain, **k: (drawn.append(self), plain(self, *a, **k)))
    axes = env._viewer._parts[1].axes
    seen = set()
    for _ in range(60):
        env.step(np.full_like(env.action_space.sample(), -1.0))
        drawn.clear()
        env.render()
        seen.add(frozenset(axes.index(a) for a in drawn if isinstance(a, Axes)))
        assert bool(drawn) == any(isinstance(a, Axes) for a in drawn)
    assert {frozenset(), frozenset({4})} <= seen


@pytest.mark.parametrize(("backlog", "unit"), [(9e2, "kW s"), (0.9e6, "kW s"), (1.1e6, "MW s"), (9e8, "MW s")])
@pytest.mark.slow
def test_names_of_axes_keep_clear_of_long_figures(backlog, unit):
    env = make("toy6", datacenters={"p_rated_kw": 250.0})
    env.render()
    curves = env._viewer._parts[1]
    curves._settle(env._viewer._histories[0].buses, 0.95, 1.05, backlog)
    env._viewer._figure.canvas.draw()
    assert curves.axes[4].get_ylim()[1] >= 1.05 * backlog
    assert curves.axes[4].get_ylabel() == f"backlog\n({unit})"
    for ax in curves.axes:
        name = ax.yaxis.label.get_window_extent()
        figures = [text.get_window_extent() for text in ax.get_yticklabels() if text.get_text()]
        assert figures
        assert all(name.x1 <= box.x0 for box in figures)
        assert name.x0 > 0.53 * SIZE_PX[0]  # and off the map


def test_curves_are_the_simulation():
    env = make(horizon=40)
    states = [env.transition.state]
    rng = np.random.default_rng(2)
    for _ in range(30):
        env.step(rng.uniform(-1, 1, env.action_space.shape))
        states.append(env.transition.state)
    env.render()
    t = np.arange(31.0)
    for name, values in {
        "v_pu": [s.v_agent_pu[0, 0] for s in states],
        "f_mhz": [s.f_mhz[0, 0] for s in states],
        "p_kw": [s.p_kw[0, 0] for s in states],
        "q_kvar": [s.q_kvar[0, 0] for s in states],
        "backlog_kws": [s.backlog_kws[0, 0] for s in states],
        "p_ref_kw": [s.p_kw[0, 0] - s.served_kw[0, 0] + s.arrived_kw[0, 0] for s in states],
    }.items():
        np.testing.assert_allclose(curve(env, name), np.column_stack((t, values)), rtol=1e-6, err_msg=name)
    np.testing.assert_allclose(curve(env, "v_pu", 2)[:, 1], [s.v_agent_pu[0, 2] for s in states], rtol=1e-6)
    v = states[-1].v_pu[0]
    title, below = titles(env)
    assert title == "toy6   train split   t = 30 of 40 s"
    assert f"{v.min():.4f} p.u. at bus {env.scenario.feeder.bus_ids[v.argmin()]};" in below
    assert f"{(np.abs(v[1:] - 1) > 0.05).sum()} of 5 buses outside 0.95 to 1.05" in below


@pytest.mark.slow
def test_a_new_episode_starts_from_an_empty_history():
    env = make()
    first = env.render()
    run(env, 25)
    assert len(curve_after_render(env, "v_pu")) == 26
    env.reset(seed=0)
    np.testing.assert_array_equal(env.render(), first)
    assert len(curve(env, "v_pu")) == 1


def curve_after_render(env, name, env_index=0):
    env._viewer.draw(env_index)
    return curve(env, name)


@pytest.mark.slow
def test_frames_without_steps_in_between_miss_nothing():
    env, seldom = make(), make()
    for _ in range(4):
        run(env, 1)
        env.render()
        run(seldom, 1)
    np.testing.assert_array_equal(curve_after_render(env, "p_kw"), curve_after_render(seldom, "p_kw"))


def test_a_restored_environment_is_drawn_from_where_it_went_on():
    env = make()
    run(env, 5)
    saved = env.save()
    run(env, 10)
    env.restore(saved)
    run(env, 2)
    assert curve_after_render(env, "v_pu")[:, 0].tolist() == [0, 1, 2, 3, 4, 5, 6, 7]
    env.reset(seed=9)
    env.restore(saved)
    run(env, 2)
    assert curve_after_render(env, "v_pu")[:, 0].tolist() == [5, 6, 7]


@pytest.mark.slow
def test_a_batch_gives_an_image_of_each_environment():
    batch: Any = gymnasium.make_vec("dcgrid/Toy6-v0", num_envs=3, render_mode="rgb_array", horizon=9)
    singles = [make(horizon=9) for _ in range(3)]
    batch.reset(seed=0)
    for i, single in enumerate(singles):
        single.reset(seed=i)
    rng = np.random.default_rng(3)
    for k in range(6):
        action = rng.uniform(-1, 1, (3, 4))
        batch.step(action)
        for i, single in enumerate(singles):
            single.step(action[i])
        if k == 3:
            batch.reset(options={"reset_mask": np.array([False, True, False])})
            singles[1].reset()
    frames = batch.render()
    assert isinstance(frames, tuple)
    for frame, single in zip(frames, singles, strict=True):
        np.testing.assert_array_equal(frame, single.render())
    for _ in range(3):
        batch.step(np.zeros((3, 4)))
    np.testing.assert_array_equal(batch.unwrapped._viewer.draw(0), batch.render()[0])
    assert (
        len(curve_after_render(batch.unwrapped, "v_pu", env_index=0)) == 1
    )  # environment 0 has begun its next episode
    assert len(curve_after_render(batch.unwrapped, "v_pu", env_index=1)) == 6


def test_an_environment_that_begins_in_the_next_step_is_drawn_from_there():
    batch = dcgrid_env.DcgridVectorEnv(2, "toy6", render_mode="rgb_array", horizon=2, autoreset_mode="next_step")
    batch.reset(seed=0)
    lengths = []
    for _ in range(4):
        batch.step(np.zeros((2, 4)))
        lengths.append(len(curve_after_render(batch, "v_pu", env_index=1)))
    assert lengths == [2, 3, 1, 2]


def test_a_window_shows_environment_0_of_a_batch(caplog):
    batch = dcgrid_env.DcgridVectorEnv(3, "toy6", render_mode="human")
    batch.reset(seed=0)
    assert batch.render() is None
    assert len(batch._viewer._histories) == 1


def test_history_keeps_no_batch_alive():
    batch = dcgrid_env.DcgridVectorEnv(500, "toy6", render_mode="rgb_array")
    batch.reset(seed=0)
    batch.step(np.zeros((500, 4)))
    assert len(batch._viewer._histories) == 500
    for history in (batch._viewer._histories[0], batch._viewer._histories[499]):
        arrays = [a for a in vars(history).values() if isinstance(a, np.ndarray)]
        assert len(arrays) >= 5
        assert all(a.base is None and len(a) == 101 for a in arrays if a is not history.order)


def test_drawing_before_an_episode_is_refused():
    viewer = Viewer(dcgrid_env.make_scenario("toy6"), "rgb_array")
    with pytest.raises(RuntimeError, match="nothing to draw yet"):
        viewer.draw()


@pytest.mark.slow
def test_copies_draw_for_themselves():
    env = make()
    run(env, 3)
    frame = env.render()
    for other in (copy.deepcopy(env._viewer), pickle.loads(pickle.dumps(env._viewer))):
        np.testing.assert_array_equal(other.draw(), frame)
        assert other._figure is not env._viewer._figure


@pytest.mark.slow
def test_neither_the_settings_of_the_user_nor_the_drawing_touch_each_other():
    frame = make().render()
    with matplotlib.rc_context({"font.size": 30.0, "axes.facecolor": "black", "text.color": "red", "axes.grid": False}):
        before = dict(matplotlib.rcParams)
        env = make()
        np.testing.assert_array_equal(env.render(), frame)
        assert dict(matplotlib.rcParams) == before


@pytest.mark.slow
def test_no_figure_is_left_behind():
    for mode in ("rgb_array", "human"):
        env = make(render_mode=mode)
        run(env, 1)
        env.render()
        env.reset()
        env.render()
        env.close()
    assert pyplot.get_fignums() == []


@pytest.mark.slow
def test_close_can_be_followed_by_a_reset():
    env = make()
    frame = env.render()
    env.close()
    env.close()
    env.reset(seed=0)
    np.testing.assert_array_equal(env.render(), frame)


def test_human_without_a_display_draws_and_says_so_once(caplog):
    caplog.set_level(logging.WARNING, "dcgrid_env.rendering.viewer")
    env = make(render_mode="human")
    run(env, 2)
    env.reset()
    assert env.render() is None
    assert [r.levelname for r in caplog.records if r.name == "dcgrid_env.rendering.viewer"] == ["WARNING"]
    assert "no window" in caplog.text
    assert titles(env)[0].endswith("t = 0 of 100 s")


class WindowManager(FigureCanvasAgg.manager_class):
    shown = 0

    def show(self):
        WindowManager.shown += 1


class WindowCanvas(FigureCanvasAgg):
    manager_class = WindowManager  # pyright: ignore[reportAssignmentType]
    flushed = 0

    def flush_events(self):
        WindowCanvas.flushed += 1


class BrokenManager(WindowManager):
    @classmethod
    def create_with_canvas(cls, canvas_class, figure, num):
        raise OSError("cannot open display")


class BrokenCanvas(FigureCanvasAgg):
    manager_class = BrokenManager  # pyright: ignore[reportAssignmentType]


@pytest.fixture
def use_backend(monkeypatch):
    def use(canvas):
        module = ModuleType("dcgrid_test_backend")
        vars(module).update(FigureCanvas=canvas, FigureManager=canvas.manager_class)
        monkeypatch.setitem(sys.modules, "dcgrid_test_backend", module)
        matplotlib.use("module://dcgrid_test_backend")

    return use


@pytest.mark.slow
def test_human_with_a_toolkit_that_cannot_open_a_window(use_backend, caplog):
    use_backend(BrokenCanvas)
    env = make(render_mode="human")
    assert env.render() is None
    assert [r.getMessage() for r in caplog.records if "cannot open display" in r.getMessage()]
    assert pyplot.get_fignums() == []


@pytest.mark.slow
def test_human_with_windows_shows_one_and_gives_it_back(use_backend, caplog):
    use_backend(WindowCanvas)
    env = make(render_mode="human")
    run(env, 2)
    assert env.render() is None
    assert WindowManager.shown == 1
    assert WindowCanvas.flushed == 4  # reset, two steps, render
    assert len(pyplot.get_fignums()) == 1
    assert not caplog.records

    pyplot.close("all")  # the user closes the window: the episode goes on
    run(env, 1)
    assert env.render() is None
    assert WindowCanvas.flushed == 4
    env.close()

    env = make(render_mode="human")
    assert len(pyplot.get_fignums()) == 1
    env.close()
    assert pyplot.get_fignums() == []


@pytest.mark.parametrize(
    ("scenario", "overrides"),
    [
        ("ieee123", {"n_datacenters": 12, "inverters.buses": ()}),
        ("toy6", {"n_datacenters": 0, "datacenters.buses": ()}),
        ("toy6", {"cost.band_pu": 0.0, "trace": "inference", "dt_s": 60.0}),
        ("ieee123", {"feeder": "khodr141"}),
    ],
)
def test_other_scenarios_can_be_drawn(scenario, overrides):
    env = make(scenario, **overrides)
    first = env.render()
    run(env, 3)
    assert is_image(first)
    assert (env.render() != first).any()


@pytest.mark.slow
def test_time_is_given_in_the_unit_that_fits():
    env = make("ieee123", dt_s=60.0, horizon=90)
    env.render()
    assert titles(env)[0].endswith("t = 0 of 90 min")


def test_a_voltage_collapse_is_named():
    env = make(datacenters={"p_rated_kw": 2500.0})
    run(env, 1)
    now = env._simulation.now
    transition = now.transition._replace(converged=np.array([False]), terminated=np.array([True]))
    env._viewer.record(now._replace(transition=transition))
    assert is_image(env.render())
    assert "voltage collapse" in titles(env)[1]


@pytest.mark.slow
def test_render_modes_of_gymnasium():
    env = gymnasium.make("dcgrid/Toy6-v0", render_mode="rgb_array")
    env.reset(seed=0)
    assert is_image(env.render())
    env.step(env.action_space.sample())
    assert is_image(env.render())
    env.close()
    env = gymnasium.make("dcgrid/Toy6-v0", render_mode="human")
    env.reset(seed=0)
    assert env.render() is None
    env.close()


@pytest.mark.slow
def test_pettingzoo_render_test():
    from pettingzoo.test import render_test

    render_test(dcgrid_env.env)  # pyright: ignore[reportArgumentType]


def test_names_stand_at_their_own_buses_whatever_the_order_of_the_devices():
    base = dcgrid_env.make_scenario("toy6")
    env = dcgrid_env.DcgridEnv(base.replace(devices=base.devices[::-1]), render_mode="rgb_array")
    env.reset(seed=0)
    env.render()
    drawn = env._viewer._parts[0].feeder
    written = {text.get_text() for text in drawn.ax.texts if text.get_visible()}
    assert {f"inv_{i} ({bus})" for i, bus in enumerate(base.inverters.buses)} <= written
    assert "dc_0 (4)" in written
