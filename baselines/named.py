"""Controllers by name, as the command line knows them."""

from __future__ import annotations

from collections.abc import Callable

from dcgrid_env.baselines.controller import Controller
from dcgrid_env.baselines.droop import Droop
from dcgrid_env.baselines.none import NoControl

CONTROLLERS: dict[str, tuple[str, Callable[[], Controller]]] = {
    "none": ("top clock, no reactive power", NoControl),
    "inverters": ("reactive droop at the inverters alone, data centres uncontrolled", lambda: Droop(datacenters=False)),
    "droop": ("the paper's droop on both axes, k_p = 1 MW/p.u., k_q = 0.5 Mvar/p.u. s, alpha = 0.3 /s", Droop),
    "droop-q": ("the same without the active axis (k_p = 0)", lambda: Droop(k_p_mw_per_pu=0.0)),
    "droop-one-step": ("the paper's droop with its printed one-step memory", lambda: Droop(memory="one_step")),
}
"""Description and factory of each."""


def make_controller(name: str) -> Controller:
    """A fresh controller; ValueError for an unknown name, listing those that exist."""
    if name not in CONTROLLERS:
        raise ValueError(f"unknown controller {name!r}; there are {', '.join(CONTROLLERS)}")
    return CONTROLLERS[name][1]()
