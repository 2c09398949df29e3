"""The study's figures: which there are, what each shows, and writing them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from dcgrid_env.study.feeder_figures import BUSES, against_number, four_buses, map_figure, step_figure
from dcgrid_env.study.load_figures import (
    SITE,
    before_and_after,
    episode_with_a_burst,
    four_models,
    training_and_inference,
)
from dcgrid_env.study.runs import Runs

FOLDER = "images"
DPI = 90

CAPTIONS = {
    1: "Training and inference power. The paper's recordings are not published; these are the generators' "
    "counterparts, of eight seeds each the one that moves most.",
    2: "Four models under the same waves of queries. The paper's recordings are not published; these are generated.",
    3: "toy6: 2.5 MW come on at 20 s. In the paper the voltage rises when load is added, a sign error; here it falls.",
    4: "IEEE 123-bus equivalent with the inverters and the eight data-centre buses of the public code, at base load "
    "with every site at its rating and no control.",
    5: "Deviation against the number of data centres. The gain over inverters only is that of the data centres' "
    "reactive power; the clock's (k_p = 1) cannot be seen.",
    6: f"Buses {', '.join(map(str, BUSES[:-1]))} and {BUSES[-1]} over two minutes with all eight published data "
    f"centres. Dashed: the band. Of the episodes the one in which the load at bus {SITE} moves most.",
    7: f"Load at bus {SITE}, near the end of the feeder, before and after control in the same episode, and the work "
    "that waits. Near the substation, as at bus 13, V is above 1 and the clock never comes down.",
}


def draw_all(runs: Runs, folder: Path) -> list[dict[str, Any]]:
    """Write the figures into ``folder``/images; number, file and caption of each."""
    seed = episode_with_a_burst(runs)
    makers: dict[int, Callable[[], Figure]] = {
        1: lambda: training_and_inference(runs),
        2: lambda: four_models(runs),
        3: lambda: step_figure(runs),
        4: lambda: map_figure(runs),
        5: lambda: against_number(runs),
        6: lambda: four_buses(runs, seed),
        7: lambda: before_and_after(runs, seed),
    }
    (folder / FOLDER).mkdir(parents=True, exist_ok=True)
    made = []
    for number, caption in CAPTIONS.items():
        file = f"{FOLDER}/reproduction-fig{number}.png"
        makers[number]().savefig(folder / file, dpi=DPI)
        made.append({"figure": number, "file": file, "caption": caption})
    return made
