"""Learning curves out of folders."""

import json

import numpy as np
import pytest

from dcgrid_env.agents import Card
from dcgrid_env.agents.curves_command import ending
from dcgrid_env.agents.training.curves import Curve, Line, curves_figure, lines, read
from dcgrid_env.cli.main import main


def run(folder, seed=0, algorithm="ppo", scenario="toy6", view="shared", rows=((10.0, 2.0), (20.0, 0.5))):
    """A training folder: rows are seconds and J, the droop's J is 1."""
    folder.mkdir(parents=True)
    lines = ["step,J,J_droop,env_steps,seconds", *(f"{i},{j},1.0,{1000 * i},{s}" for i, (s, j) in enumerate(rows))]
    (folder / "curve.csv").write_text("\n".join(lines) + "\n")
    (folder / "config.json").write_text(json.dumps({"view": view}))
    Card.of("0" * 64, 5, {"algorithm": algorithm, "scenario": scenario, "seed": seed}).save(folder / "policy.json")
    return folder


def test_a_curve_is_what_the_folder_says(tmp_path):
    found = read(run(tmp_path / "a", seed=4, view="centralised"))
    assert (found.scenario, found.label, found.seed) == ("toy6", "ppo, centralised", 4)
    np.testing.assert_allclose(found.x, [10.0, 20.0])
    np.testing.assert_allclose(found.gain_pct, [-100.0, 50.0])
    assert read(tmp_path / "a", "steps").x.tolist() == [0.0, 1000.0]
    assert read(run(tmp_path / "b", rows=((10.0, ""), (20.0, 0.5)))).x.tolist() == [20.0]


def test_a_line_is_the_mean_of_its_runs_as_good_as_at_their_last_validation():
    one = Curve("toy6", "ppo", 0, np.array([1.0, 4.0, 16.0]), np.array([0.0, 10.0, 20.0]))
    other = Curve("toy6", "ppo", 1, np.array([2.0, 8.0]), np.array([-10.0, 30.0]))
    alone = Curve("toy6", "sac", 0, np.array([2.0, 8.0]), np.array([-10.0, 30.0]))
    found = lines([one, other, alone])
    together, single = found["toy6"]
    assert together.x[[0, -1]] == pytest.approx([2.0, 8.0])
    at_5 = int(np.searchsorted(together.x, 5.0))
    assert (together.low_pct[at_5], together.mean_pct[at_5], together.high_pct[at_5]) == (-10.0, 0.0, 10.0)
    assert together.mean_pct[-1] == pytest.approx(20.0)
    assert (single.label, single.n_runs) == ("sac", 1)
    np.testing.assert_array_equal(single.x, alone.x)


def test_a_folder_that_holds_no_run_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"none: there is no curve\.csv; give the folder of a training run"):
        read(tmp_path / "none")
    empty = run(tmp_path / "empty", rows=())
    with pytest.raises(ValueError, match=r"curve\.csv: holds no validation yet"):
        read(empty)
    broken = run(tmp_path / "broken")
    (broken / "curve.csv").write_text("step,J,seconds\n1,2.0,3.0\n")
    with pytest.raises(ValueError, match=r"curve\.csv: column J_droop is missing"):
        read(broken)
    (run(tmp_path / "bare") / "config.json").write_text("[]")
    with pytest.raises(ValueError, match=r"config\.json: is no configuration"):
        read(tmp_path / "bare")
    with pytest.raises(ValueError, match="seed 0 of ppo on toy6 is there twice"):
        lines([read(run(tmp_path / name)) for name in ("x", "y")])


@pytest.mark.slow
def test_the_figure_has_a_panel_for_each_scenario(tmp_path):
    names = ("toy6", "ieee123", "ieee33", "das69", "khodr141")
    curves = [
        read(run(tmp_path / f"{name}-{algorithm}-{seed}", seed, algorithm, name))
        for name in names
        for algorithm in ("ppo", "analytic")
        for seed in (0, 1)
    ]
    assert curves_figure(lines(curves), "steps").axes[0].get_xlabel() == "environment steps"
    figure = curves_figure(lines(curves))
    assert figure.axes[0].get_xlabel() == "training time (s)"
    shown = [ax for ax in figure.axes if ax.get_visible()]
    assert [ax.get_title() for ax in shown] == list(names)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["ppo", "analytic"]
    figure.canvas.draw()


@pytest.mark.parametrize(
    ("gains_pct", "said"),
    [
        ([7.24], "1 run, final J 7.24 % below the tuned droop's"),
        ([-7.24], "1 run, final J 7.24 % above the tuned droop's"),
        ([-1e-9], "1 run, final J 0.00 % below the tuned droop's"),
        (
            [1.0, -4.0],
            "2 runs, final J 1.50 % above the tuned droop's on average (best 1.00 % below, worst 4.00 % above)",
        ),
    ],
)
def test_where_a_line_ends_is_said_as_below_or_above(gains_pct, said):
    gains = np.array(gains_pct)[:, None]
    ends = (gains.mean(axis=0), gains.min(axis=0), gains.max(axis=0))
    assert ending(Line("ppo", np.array([1.0]), *ends, n_runs=len(gains))) == said


def test_the_command_draws_and_says_where_each_line_ends(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run(tmp_path / "a")
    main(["curves", "a", "--out", "images/curves.png"])
    assert (tmp_path / "images" / "curves.png").read_bytes()[:4] == b"\x89PNG"
    assert "toy6, ppo: 1 run, final J 50.00 % below the tuned droop's" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("folders", "said"),
    [
        (["nowhere"], "nowhere: there is no curve.csv; give the folder of a training run"),
        ([], "folders: must name at least one folder of a training run, got none"),
    ],
)
def test_the_command_refuses_what_is_no_run(folders, said, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["curves", *folders])
    assert capsys.readouterr().err.startswith(f"dcgrid: {said}")
