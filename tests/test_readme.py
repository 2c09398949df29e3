"""What the README claims, run again."""

import re
from pathlib import Path

import numpy as np
import pytest

import dcgrid_env
from dcgrid_env import make_scenario
from dcgrid_env.baselines import make_controller, rollout

README = (Path(__file__).parents[1] / "README.md").read_text()


def table(scenario):
    """The README's results of a scenario: controllers, and rows by their label."""
    lines = README[README.index(f"| `{scenario}` | none |") :].split("\n\n")[0].splitlines()
    cells = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]
    return cells[0][1:], {row[0]: [float(x) for x in row[1:]] for row in cells[2:]}


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["ieee123", "ieee33-weak"])
def test_results_are_those_of_the_command(scenario):
    controllers, rows = table(scenario)
    test = make_scenario(scenario, split="test")
    for i, name in enumerate(controllers):
        found = rollout(test, make_controller(name), range(100)).metrics()
        for label, key, decimals in (
            ("J", "J", 4),
            (r"mean \|V-1\|, p.u.", "voltage_deviation_mean_pu", 4),
            ("bus-seconds outside, %", "outside_bus_seconds_pct", 2),
            ("mean delay, s", "delay_mean_s", 2),
            ("unserved at the end, kW s", "unserved_kws", 1),
            ("mean loss, kW", "loss_mean_kw", 1),
        ):
            # Half a digit, and a little for the last bits of another processor's sums.
            assert np.mean([m[key] for m in found]) == pytest.approx(rows[label][i], abs=0.51 * 10.0**-decimals), label


def test_python_examples_run(capsys):
    blocks = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len(blocks) == 4
    for block in blocks:
        exec(compile(block, "README.md", "exec"), {})
    printed = capsys.readouterr().out.split()
    assert [round(float(x), 4) for x in printed[:2]] == [0.9131, 202.6771]


def test_every_id_and_scenario_is_named():
    for name, scenario in dcgrid_env.IDS.items():
        assert f"| `{name}` | `{scenario}` |" in README
