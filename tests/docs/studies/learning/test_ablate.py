"""Variants, and policies on other scenarios than their own."""

from pathlib import Path

import numpy as np
import pytest

from dcgrid_env.agents import Network, Policy
from dcgrid_env.agents.algorithms.analytic import Analytic
from dcgrid_env.agents.algorithms.safe import Safe
from docs.studies.learning import ablate
from docs.studies.learning.scored import droop_on_test, scored


def policy(q=0.3, n_in=(9, 7), scenario="toy6"):
    """Full clock and a constant share of the reactive limit."""
    dc = Network([(np.zeros((n_in[0], 2)), (1.0, q))])
    return Policy({"datacenter": dc, "inverter": Network([(np.zeros((n_in[1], 1)), [q])])}, scenario=scenario)


def test_variants_differ_in_what_they_say_and_never_meet(tmp_path):
    runs = ablate.configs({"analytic": Analytic, "safe": Safe}, "ieee33-weak", {"updates": 5}, 2, tmp_path)
    assert list(runs) == [*ablate.VARIANTS, ablate.SAFE]
    assert len({one.out for every in runs.values() for one in every}) == 2 * len(runs)
    for label, own in ablate.VARIANTS.items():
        for seed, one in enumerate(runs[label]):
            assert one == Analytic(scenario="ieee33-weak", updates=5, seed=seed, out=one.out, **own)
    assert runs[ablate.SAFE][0].hidden == Safe().hidden
    assert ablate.SAFE not in ablate.configs({"analytic": Analytic}, "toy6", {}, 1, tmp_path)


def test_a_variant_that_failed_is_a_row_and_says_why(tmp_path):
    runs = ablate.configs({"analytic": Analytic}, "toy6", {}, 1, tmp_path)
    failures = {every[0].out: "training diverged at step 7" for every in runs.values()}
    found = ablate.ablation("toy6", 2, runs, failures)
    made = ablate.ablation_table("toy6", 2, found)
    assert made.rows[1][:3] == ("clock only", "failed", "–")
    assert made.rows[-1][0] == "droop-tuned"
    assert made.rows[-1][1].startswith("0.000 ")
    assert made.notes[1] == "clock only: training diverged at step 7"
    assert {len(row) for row in made.rows} == {len(made.header)}
    page = ablate.markdown(made, found, None, "python -m docs.studies ablate")
    assert (
        f"# clock only\ndcgrid train analytic --scenario toy6 --out {Path(runs['clock only'][0].out)} --act clock"
        in page
    )


def test_transfer_marks_the_own_scenario_and_what_does_not_fit():
    policies = {"toy6-analytic": policy(), "wider": policy(n_in=(11, 7), scenario="ieee33")}
    made = ablate.transfer_table(policies, ["toy6", "ieee33"], 2)
    assert made.header == ("policy", "toy6", "ieee33")
    (own, *cells), (other, *none) = made.rows
    droop = droop_on_test("toy6", 2)
    value = scored([policies["toy6-analytic"]], "toy6", 2).score(droop)
    assert value is not None
    assert (own, cells[0]) == ("toy6-analytic", f"[{value.value:.2f}]")
    assert float(cells[1]) == pytest.approx(float(cells[1]))
    assert (other, none) == ("wider (on ieee33)", ["–", "–"])
