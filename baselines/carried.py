"""What a user's files hold that options name, as objects for workers that do not see those files.

A user's scenarios, controllers and policies are read once and sent to every node of a cluster. Bundled objects, and
those that other packages register, are made on each node by their name.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from dcgrid_env.baselines.registry import CARRIED as CONTROLLERS
from dcgrid_env.baselines.registry import own_controllers
from dcgrid_env.baselines.scenario_spec import CARRIED as SCENARIOS
from dcgrid_env.baselines.scenario_spec import own_scenarios
from dcgrid_env.baselines.tuning.tuned import CARRIED as PARAMETERS
from dcgrid_env.baselines.tuning.tuned import own_parameters
from dcgrid_env.core.work.unit import Place


def carried(
    place: Place, scenarios: Iterable[str] = (), controllers: Iterable[str] = (), tuned: Path | None = None
) -> dict[str, Any]:
    """Shared values for units of a place; nothing for one that sees this machine's files.

    Parameters
    ----------
    place
        Where the units run.
    scenarios, controllers
        What the command line names them by.
    tuned
        A file of ``dcgrid tune``; without it the one of the working directory, where it is there.
    """
    if not place.is_remote:
        return {}
    return {
        SCENARIOS: own_scenarios(scenarios),
        CONTROLLERS: own_controllers(controllers),
        PARAMETERS: own_parameters(tuned),
    }
