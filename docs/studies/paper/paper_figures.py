"""Draw and write the study's figures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dcgrid_env.apps.reproduction.bus13 import BUS
from dcgrid_env.apps.reproduction.paper import PUBLISHED_BUSES
from dcgrid_env.apps.reproduction.study_runs import BOTH, Runs
from dcgrid_env.apps.reproduction.table1 import gains
from dcgrid_env.core.files import write_figure
from docs.studies.paper.feeder_figures import (
    BUSES,
    FIGURE_6_SITES,
    against_number,
    figure_six,
    four_buses,
    map_figure,
    step_figure,
)
from docs.studies.paper.load_figures import (
    SITE,
    all_sites,
    before_and_after,
    episode_with_a_burst,
    four_models,
    panel_laws,
    training_and_inference,
)

FOLDER = "images"
DPI = 90
BUSIEST = 25
"""Data centre whose load chooses the episode of Fig. 6."""
LEAST_VISIBLE_PCT = 0.5
"""A gain of less lies within the line of another law in Fig. 5, %."""


def captions(runs: Runs, seed: int) -> dict[int, str]:
    """Return the caption of each figure; ``seed`` is the episode of Fig. 7."""
    return {
        1: "Training and inference power. The paper's recordings are not published; these are "
        "generated: of eight seeds each, the one that varies most.",
        2: "Four models with the same bursts of queries. The paper's recordings are not published; these are "
        "generated.",
        3: "toy6: the voltage at the data centre when its load of 2.5 MW starts and when it stops. The paper does not "
        "state which of the two its figure shows.",
        4: "IEEE 123-bus equivalent with the inverters and the eight data-centre buses of the public code, at base "
        "load with every site at its rating and no control.",
        5: f"Deviation against the number of data centres. {_split(runs)}",
        6: f"The paper's buses over two minutes: {', '.join(f'{bus} ({what})' for bus, what in BUSES.items())}; both "
        f"axes at k_p = 10. Data centres at {', '.join(map(str, FIGURE_6_SITES))}. Dashed lines: the voltage band. In "
        f"this episode the load at bus {BUSIEST} varies most.",
        7: f"Load at bus {SITE}, near the end of the feeder, before and after control in the same episode, and the "
        f"backlog. {_near_the_substation(runs, seed)}",
    }


def _split(runs: Runs) -> str:
    """Means over the numbers of sites at k_p = 1, the gain of Fig. 5."""
    rows = [row for row in gains(runs) if row["k_p_mw_per_pu"] == BOTH.k_p_mw_per_pu]
    reactive, active = (float(np.mean([row[f"gain_{axis}_pct"] for row in rows])) for axis in ("reactive", "active"))
    remark = ", too little to be seen" * (abs(active) < LEAST_VISIBLE_PCT)
    return (
        f"On average it is lower than with inverters only: by {reactive:.1f} % through the data centres' reactive "
        f"power and by {active:.2f} % through the clock (k_p = 1){remark}."
    )


def _near_the_substation(runs: Runs, seed: int) -> str:
    """At bus 13 under the laws of Fig. 7: how low the voltage goes, and how much work waits."""
    scenario, site = all_sites(runs), PUBLISHED_BUSES.index(BUS)
    all_series = [runs.series(scenario, law, seed) for law in panel_laws()]
    lowest_pu = min(float(series.v_pu[:, scenario.feeder.index(BUS)].min()) for series in all_series)
    most_kws = max(float(series.backlog_kws[:, site].max()) for series in all_series)
    waits = f"up to {most_kws:.0f} kW s of work wait" if most_kws >= 1.0 else "no work waits"
    return f"Near the substation, at bus {BUS}, V is {lowest_pu:.3f} p.u. at least and {waits}."


def draw_all(runs: Runs, folder: Path) -> list[dict[str, Any]]:
    """Write the figures into ``folder``/images; number, file and caption of each."""
    seed = episode_with_a_burst(runs, all_sites(runs), SITE)
    makers: dict[int, Callable[[], Figure]] = {
        1: lambda: training_and_inference(runs),
        2: lambda: four_models(runs),
        3: lambda: step_figure(runs),
        4: lambda: map_figure(runs),
        5: lambda: against_number(runs),
        6: lambda: four_buses(runs, episode_with_a_burst(runs, figure_six(runs), BUSIEST)),
        7: lambda: before_and_after(runs, seed),
    }
    records = []
    for number, caption in captions(runs, seed).items():
        file = f"{FOLDER}/reproduction-fig{number}.png"
        write_figure(folder / file, makers[number](), dpi=DPI)
        records.append({"figure": number, "file": file, "caption": caption})
    return records
