"""The study of the recorded dips: its figures are those of the episodes, its page and figure hold them."""

import numpy as np
import pytest

from dcgrid_env import make_scenario, sag_times
from dcgrid_env.baselines import ReturnByHand, published, rollout
from docs.studies.laws import sag_study
from docs.studies.laws.sag_study import COLUMNS, Sags, markdown, sag_figure, table

NAMES = ["none", "return-by-hand"]


@pytest.fixture(scope="module")
def study():
    return sag_study.sag_study("ride-through", NAMES, 2, 1, best=True)


@pytest.mark.slow
def test_figures_are_those_of_the_episodes(study):
    test = make_scenario("ride-through", split="test")
    metrics = rollout(test, ReturnByHand(), range(2)).metrics()
    named = {one.name: one for one in study.driven}
    assert list(named) == ["none", "return-by-hand", "best known"]  # the dearest first
    by_hand = dict(zip([(m.name, how) for m, how in COLUMNS], named["return-by-hand"].figures, strict=True))
    assert by_hand["ups_trips", "mean"] == np.mean([one["ups_trips"] for one in metrics])
    assert by_hand["voltage_after_loss_max_pu", "most"] == max(one["voltage_after_loss_max_pu"] for one in metrics)
    lost = np.mean([one["ups_lost_step_kw"] for one in metrics])
    assert by_hand["lost_step_pct", "mean"] == pytest.approx(100.0 * lost / study.load_kw)
    assert study.load_kw == pytest.approx(1769.0 + 3 * 450.0)
    costs = published(test)
    assert costs is not None
    assert named["best known"].figures[0] == pytest.approx(costs.select([0, 1]).J.mean())


@pytest.mark.slow
def test_sags_are_where_sites_leave(study):
    course = study.driven[0].course
    begin_s = sag_times(study.scenario, 1)
    assert len(begin_s) == 6
    assert np.ptp(begin_s) == pytest.approx(82.0)
    first = int(np.floor(begin_s[0]))
    assert course.sites_kw[first - 1].min() > 0.0
    assert not course.sites_kw[first].any()


def test_the_page_and_the_figure_hold_all(study):
    page = markdown(study, "python -m docs.studies sags", "images/sag-study.png")
    assert "Made by\n\n    python -m docs.studies sags\n" in page
    assert all(len(line) <= 120 for line in page.splitlines() if not line.startswith(("|", "!")))
    assert table(study).rows[0][0] == "none"
    figure = sag_figure(study)
    assert len(figure.axes) == 9
    assert [ax.get_title() for ax in figure.axes[:3]] == [
        "no control", "return-by-hand", "best known (no bound)"
    ]  # fmt: skip
    said = figure.axes[1].texts[0].get_text()
    assert f"{study.driven[1].course.figures['ups_trips']:.0f} trips" in said


@pytest.mark.slow
def test_the_command_writes_page_and_figure(tmp_path, capsys):
    Sags(controllers="none", beside="return-by-hand", episodes=1, seed=0, out=tmp_path).run()
    assert (tmp_path / "sag-study.md").read_text().startswith("# Six voltage sags in 82 seconds\n")
    assert (tmp_path / "images/sag-study.png").stat().st_size > 10_000
    assert "wrote" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("ride-through", NAMES, 2, 2), "seed is 2; give one of the 2 episodes"),
        (("toy6", NAMES, 2, 0), "scenario is 'toy6', which has no sags or no sites that leave"),
    ],
)
def test_what_cannot_be_studied(given, message):
    with pytest.raises(ValueError, match=message):
        sag_study.sag_study(*given)
