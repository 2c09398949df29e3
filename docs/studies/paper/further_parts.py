"""Parts of the study that only the page has: stability, other feeders, the load, and settings close to Table I."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dcgrid_env.apps.reproduction.paper import K_P_MW_PER_PU
from dcgrid_env.apps.reproduction.study import PARTS, Part
from dcgrid_env.apps.reproduction.study_runs import Runs
from dcgrid_env.baselines import Droop
from dcgrid_env.baselines.laws.stability import worst_radius
from docs.studies.paper import load_claims, load_swings, power_axes
from docs.studies.paper.guess import guesses


def stability(runs: Runs) -> list[dict[str, float]]:
    """Largest spectral radius of the linear closed loop over placements; above 1 the law oscillates."""
    return [
        {"n_datacenters": n, "k_p_mw_per_pu": k_p}
        | {"spectral_radius": worst_radius(runs.setting.scenario(n), Droop(k_p_mw_per_pu=k_p))}
        for n in runs.setting.counts
        for k_p in K_P_MW_PER_PU
    ]


ALL_PARTS: Mapping[str, Part] = {
    **PARTS,
    "stability": stability,
    "axes": power_axes.axes,
    "dips": load_swings.dips,
    "ramps": load_swings.ramps,
    "models": load_swings.models,
    "guesses": guesses,
}
"""Parts of the study, and those of the page."""


def with_further_claims(records: dict[str, Any]) -> dict[str, Any]:
    """Return the records with the claims on other feeders and on the load added to the others."""
    further = (power_axes.active, load_claims.taps, load_claims.ramps, load_claims.larger_models)
    return records | {"claims": [*records["claims"], *(claim(records) for claim in further)]}
