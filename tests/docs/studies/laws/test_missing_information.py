"""What true quantities save the model-aided law, as docs/studies/laws/missing_information.py prints it."""

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.baselines import ModelAided, rollout
from docs.studies.laws import missing_information
from docs.studies.laws.missing_information import Informed


class Recording(Informed):
    """Keeps the expected voltages without a further move, and the true ones."""

    def _informed(self, local, step):
        known = super()._informed(local, step)
        if self._past.steps:
            q, p = local.q_kvar - known.origin_kvar, local.p_kw - known.mean_kw
            moved = known.by_q * q[..., None] - known.by_draw * p[..., None]
            np.testing.assert_allclose(known.base_pu[:, :, 0] + moved, self._v_pu[:, None] + 0.0 * moved, atol=1e-12)
        return known


@pytest.mark.slow
def test_every_agent_has_the_true_voltages_and_the_coming_draws_save_more():
    scenario = make_scenario("das69", split="validation")
    laws = (ModelAided(), Recording(draws=False), Informed(draws=True))
    law, voltages, draws = (rollout(scenario, one, range(4)).costs().mean() for one in laws)
    assert draws < voltages < law


@pytest.mark.slow
def test_the_table_of_quantities(monkeypatch, capsys):
    monkeypatch.setattr(missing_information, "PRESETS", ("toy6",))
    monkeypatch.setattr(missing_information, "SEEDS", range(1))
    missing_information.quantities()
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("| toy6 | score | J | voltage |")
    assert lines[2].startswith("| droop-tuned | 0.00 |")
    assert lines[-1].startswith("| hindsight | 1.00 |")
    assert len(lines) == 10
