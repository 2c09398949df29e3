"""The front: its runs, the droop law's curves, and the figure."""

import numpy as np
import pytest

from dcgrid_env.agents.algorithms.analytic import Analytic
from docs.studies.learning import pareto
from docs.studies.learning.pareto import PANELS, Front, Learned, Swept, pareto_figure
from docs.studies.learning.scored import controller_on_test, scored


def test_a_run_for_each_limit_and_seed_and_one_without(tmp_path):
    made = pareto.configs(Analytic, "toy6", [0.5, 2.0], {"updates": 3}, 2, tmp_path)
    assert [(one.delay_limit_s, one.seed) for one in made] == [(0.5, 0), (0.5, 1), (2, 0), (2, 1), (None, 0), (None, 1)]
    assert {one.updates for one in made} == {3}
    assert len({one.out for one in made}) == 6


@pytest.mark.slow
def test_the_curves_run_through_the_tuned_law_and_buy_voltage_with_delay(monkeypatch):
    monkeypatch.setattr(pareto, "K_P_MW_PER_PU", (0.0, 3.503, 7.0))
    curves = pareto.swept("ieee33-weak", 2)
    assert [(curve.alpha_per_s, curve.tuned) for curve in curves] == [(0.001, True), (0.03, False), (0.3, False)]
    tuned = controller_on_test("droop-tuned", "ieee33-weak", 2).mean.means
    assert curves[0].tested[1].mean.means == pytest.approx(tuned)
    for curve in curves:
        none, _, high = (found.mean.means for found in curve.tested)
        assert none["delay_mean_s"] == pytest.approx(0.0, abs=1e-6)
        assert high["delay_mean_s"] > 0.5
        assert high["voltage_deviation_mean_pu"] < none["voltage_deviation_mean_pu"]
    asked_back = [curve.tested[2].mean.means["delay_mean_s"] for curve in curves]
    assert asked_back == sorted(asked_back, reverse=True)


@pytest.fixture
def front():
    """A front out of droop laws in place of policies."""
    some = controller_on_test("droop", "toy6", 2)
    laws = [pareto.Droop(k_p_mw_per_pu=k_p) for k_p in (1.0, 2.0)]
    learned = (
        Learned(4.0, scored(laws, "toy6", 2), "dcgrid train analytic --delay-limit-s 4"),
        Learned(None, some, "dcgrid train analytic"),
    )
    swept = (Swept(0.3, True, (0.0, 1.0), (some, some)),)
    return Front("toy6", 2, learned, swept, {"droop-tuned": some, "mpc-one-step": some})


def test_the_page_has_figures_and_commands(front):
    page = pareto.markdown(front, "python -m docs.studies pareto --scenario toy6", "images/pareto.png")
    assert "Made by\n\n    python -m docs.studies pareto --scenario toy6\n" in page
    assert "# 4 s\ndcgrid train analytic --delay-limit-s 4\n# none, J as it is\ndcgrid train analytic\n" in page
    assert "(images/pareto.png)" in page
    row = next(line for line in page.splitlines() if line.startswith("| 4 s |"))
    each = [f"{one.means['delay_mean_s']:.2f}" for one in front.learned[0].tested.each]
    assert row.endswith(f"| {', '.join(each)} |")
    assert all(len(line) <= 120 for line in page.splitlines() if not line.startswith(("|", "!")))


def test_the_figure_holds_the_points(front):
    figure = pareto_figure(front)
    assert len(figure.axes) == len(PANELS)
    for ax, (metric, factor, _) in zip(figure.axes, PANELS, strict=True):
        line = next(one for one in ax.lines if one.get_label() == "learned, under a limit on delay")
        means = front.learned[0].tested.mean.means
        assert np.asarray(line.get_xdata()) == pytest.approx([means["delay_mean_s"]])
        assert np.asarray(line.get_ydata()) == pytest.approx([factor * means[metric]])
    figure.canvas.draw()
