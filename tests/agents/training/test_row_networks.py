"""Networks of rows as policies: errors. Actions are compared in tests/agents/from_sb3."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.agents import Network, PolicyError, policy_of_rows
from dcgrid_env.agents.training.row_form import RowForm
from dcgrid_env.agents.training.row_views import make_rows


def test_networks_of_another_width_or_with_skip_or_scale_are_refused():
    rows = make_rows(make_scenario("toy6"), RowForm("channel", "change"))
    layers = [(np.zeros((rows.n_observation, 1)), [0.0])]
    assert set(policy_of_rows(rows, Network(layers)).networks) == {"datacenter", "inverter"}
    further: dict[str, Any]
    for further in ({"skip": np.zeros((rows.n_observation, 1))}, {"scale": [0.5]}):
        with pytest.raises(PolicyError, match="network has skip or scale; give one of layers alone"):
            policy_of_rows(rows, Network(layers, **further))
    with pytest.raises(PolicyError, match=r"network takes 2 figures and gives 1; rows have \d+ and 1"):
        policy_of_rows(rows, Network([(np.zeros((2, 1)), [0.0])]))
