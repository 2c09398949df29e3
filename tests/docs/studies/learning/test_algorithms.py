"""Tables of standard algorithms: rliable's figures, and the page that shows them."""

import numpy as np
import pytest

from dcgrid_env.core.files import write_json
from docs.studies.commands import main
from docs.studies.learning.algorithms import DATA, TASKS, interquartile_mean, profile, runs_by_reward, tables
from docs.studies.learning.learning_tables import NONE
from docs.studies.learning.libraries import records_in
from docs.studies.learning.scored import droop_on_test
from helpers.places import ROOT


def test_figures_are_those_of_rliable():
    scores = np.random.default_rng(1).normal(size=(5, 3)).round(2)
    found = interquartile_mean(scores)
    # rliable 1.2.0: aggregate_iqm and get_interval_estimates with 50,000 resamples
    np.testing.assert_allclose(found, (0.191111, -0.125556, 0.431111), atol=0.02)
    thresholds = np.array([-0.5, 0.0, 0.5])
    np.testing.assert_array_equal(profile(scores, thresholds), [12 / 15, 10 / 15, 4 / 15])
    assert np.isnan(interquartile_mean(scores[:1])[1:]).all()


def record(task: str, reward: str, seed: int, share: float) -> dict[str, object]:
    """A training that ends at a share of the droop's cost."""
    j = (share * droop_on_test(task, 4).J).tolist()
    about = {"library": "sb3-ppo", "episodes": 4, "cpu_s": 2.0, "peak_mib": 300}
    return about | {"scenario": task, "reward": reward, "seed": seed, "J": j}


def test_the_tables_have_as_many_seeds_as_every_task(tmp_path, capsys):
    records = [record("ieee33-weak", "difference", seed, 0.99) for seed in (1, 0)]
    records += [record("routing", "difference", 0, 0.9), record("smoothing", "local", 0, 0.9)]
    records += [record("mixed", "shared", 0, 1.0)]
    data, figure = tmp_path / "data.json", tmp_path / "profiles.png"
    write_json(data, {"trainings": records})
    main(["algorithms", "--data", str(data), "--figure", str(figure)])
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines()]
    assert figure.stat().st_size > 1000
    assert rows[2][:2] == ["difference", "PPO"]
    assert [cell.endswith("(2)") for cell in rows[2][2:4]] == [True, False]
    assert rows[3][:4] == ["shared", "PPO", NONE, "0.00 (1)"]
    assert rows[-2][2:4] == ["2", "1"]
    assert rows[-1][2:] == ["1", "1", "0.00", "0", "2", "300"]
    write_json(data, {"trainings": [records[0] | {"library": "sb3-contrib-tqc"}]})
    with pytest.raises(SystemExit):
        main(["algorithms", "--data", str(data), "--figure", str(figure)])
    message = capsys.readouterr().err.replace("\n", " ")
    assert "has trainings of sb3-contrib-tqc; make it by `libraries` with sb3-ppo" in message


@pytest.mark.slow
def test_the_page_shows_the_tables_of_the_file():
    records = records_in(ROOT / DATA)
    assert {record["scenario"] for record in records} <= set(TASKS)
    assert tables(runs_by_reward(records)) in (ROOT / "docs" / "algorithms.md").read_text()
