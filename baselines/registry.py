"""Controllers by name, as the command line knows them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from dcgrid_env import Scenario
from dcgrid_env.baselines.controller import Controller
from dcgrid_env.baselines.laws.deadband import DeadbandDroop
from dcgrid_env.baselines.laws.droop import Droop
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.baselines.laws.static import ConstantQ, PlacementRule
from dcgrid_env.baselines.laws.switching import SwitchingReference
from dcgrid_env.baselines.laws.volt_var import VoltVar
from dcgrid_env.baselines.model_based.feedback import FeedbackOptimisation
from dcgrid_env.baselines.model_based.mpc import Mpc
from dcgrid_env.baselines.tuning.search import TUNABLE
from dcgrid_env.baselines.tuning.tuned import SUFFIX, tuned_controller

CONTROLLERS: dict[str, tuple[str, Callable[[], Controller]]] = {
    "none": ("top clock, no reactive power", NoControl),
    "inverters": ("reactive droop at the inverters alone, data centres uncontrolled", lambda: Droop(datacenters=False)),
    "droop": ("the paper's droop on both axes, k_p = 1 MW/p.u., k_q = 0.5 Mvar/p.u. s, alpha = 0.3 /s", Droop),
    "droop-q": ("the same without the active axis (k_p = 0)", lambda: Droop(k_p_mw_per_pu=0.0)),
    "droop-one-step": ("the paper's droop with its printed one-step memory", lambda: Droop(memory="one_step")),
    "droop-adaptive": (
        "the paper's droop with an alpha that grows with the backlog: 0.03 /s, doubled at 2 s of work",
        lambda: Droop(alpha_per_s=0.03, alpha_growth_per_s=0.5),
    ),
    "volt-var": ("the volt-var curve of IEEE 1547-2018, category B, with its response time of 5 s", VoltVar),
    "deadband": (
        "proportional reactive droop beyond 0.01 p.u. with a ramp limit of 10 % of the limit/s",
        DeadbandDroop,
    ),
    "switching": ("reactive droop to two references, for AI-training loads (arXiv 2603.15588)", SwitchingReference),
    "constant-q": ("the same constant share of the reactive limit at every agent", ConstantQ),
    "placement": ("a constant share that is a linear function of R_ii and X_ii", PlacementRule),
    "feedback": (
        "online feedback optimisation: projected primal-dual steps on the measured voltages of all buses",
        FeedbackOptimisation,
    ),
    "mpc-one-step": ("model predictive control of the next step", lambda: Mpc(horizon=1)),
    "mpc": ("model predictive control over 12 steps with preview and forecast", Mpc),
}
"""Description and factory of each."""

TUNED: dict[str, str] = {
    f"{law}{SUFFIX}": f"{law}, its parameters tuned on the validation split of the scenario" for law in TUNABLE
}
"""Description of those whose parameters depend on the scenario."""


def make_controller(name: str, scenario: Scenario | None = None, tuned: str | Path | None = None) -> Controller:
    """A fresh controller.

    Parameters
    ----------
    name
        One of ``CONTROLLERS`` or ``TUNED``.
    scenario
        What it is to drive; tuned controllers look up their parameters by it.
    tuned
        A file of ``dcgrid tune`` that must have them; see ``tuned.tuned_parameters`` for where they are without one.

    Raises
    ------
    ValueError
        For an unknown name, listing those that exist, or a tuned one without a scenario for which there are parameters.
    """
    if name in CONTROLLERS:
        return CONTROLLERS[name][1]()
    if name not in TUNED:
        raise ValueError(f"unknown controller {name!r}; there are {', '.join((*CONTROLLERS, *TUNED))}")
    if scenario is None:
        raise ValueError(f"controller {name!r} is tuned for each scenario; say which one it is for")
    return tuned_controller(name.removesuffix(SUFFIX), scenario, tuned)
