"""What an episode's end would charge if it were now: queued work, energy that is missing in storages, and the like."""

from __future__ import annotations

from dcgrid_env.core.arrays import Array, sum_last
from dcgrid_env.engine.parameters import parameters
from dcgrid_env.engine.reward import terms
from dcgrid_env.engine.state import State
from dcgrid_env.scenario.scenario import Scenario


def end_costs(scenario: Scenario, state: State) -> dict[str, Array]:
    """Weighted terms that an episode's last step alone is charged, as if a state were behind that step.

    By term, (lane,) each, those that devices bring and that have a weight; arrays of the state's kind, with its
    derivatives.
    """
    params, due = parameters(scenario, state.v_pu), {}
    for i, term, weight, _ in terms(scenario).charged:
        if term.at_end:
            amount = sum_last(scenario.devices[i].amount(term.amount, params.devices[i], state.devices[i]))
            share = amount / term.team_scale * weight
            due[term.name] = due[term.name] + share if term.name in due else share
    return due
