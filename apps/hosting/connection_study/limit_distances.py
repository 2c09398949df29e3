"""How near windows come to each limit of a study: value, place and time of day."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dcgrid_env import rating_coverage
from dcgrid_env.apps.hosting.capacity_study import Study
from dcgrid_env.apps.hosting.element_names import time_text
from dcgrid_env.apps.hosting.load_hours import Windows
from dcgrid_env.apps.hosting.site_search import limit_at, limit_of
from dcgrid_env.apps.hosting.trial import COLLAPSED, LIMITS, OVERLOAD, UNLIMITED, Trial
from dcgrid_env.core.text_table import Table


def time_of(study: Study, windows: Windows, window: int) -> str:
    """The time of the loads of a window, as text: with load profiles their date or day, and the time of day."""
    return study.load_words if windows.hours is None else time_text(study.scenario, float(windows.hours[window]))


def limit_values(study: Study, kind: int, margin: float) -> tuple[str, str]:
    """The value that has a margin to one of ``LIMITS``, and the limit itself, with their units."""
    half = 0.5 * (study.v_max_pu - study.v_min_pu)
    if kind == 0:
        return f"{study.v_min_pu + margin * half:.4f} p.u.", f"{study.v_min_pu:g} p.u."
    if kind == 1:
        return f"{study.v_max_pu - margin * half:.4f} p.u.", f"{study.v_max_pu:g} p.u."
    limit, unit = {
        "overload": (study.loading_max_pct, "% of the rating"),
        "voltage step": (study.voltage_step_max_pct, f"% in {study.scenario.dt_s:g} s"),
        "taps": (study.taps_max_per_hour, "per hour"),
        "loss": (study.loss_max_kw, "kW"),
    }[LIMITS[kind]]
    assert limit is not None
    return f"{(1.0 - margin) * limit:.4g} {unit}", f"{limit:g} {unit}"


def limits_table(study: Study, windows: Windows, title: str, by_controller: Mapping[str, Trial]) -> Table:
    """Make a table with a row for each controller and limit: the nearest value, its place and its window.

    Parameters
    ----------
    study, windows
        The study and its windows.
    title
        Title of the table.
    by_controller
        A trial in all windows of the study, by controller.
    """
    rows = []
    for name, trial in by_controller.items():
        if trial.margin <= COLLAPSED:
            window = int(trial.margins.min(axis=1).argmin())
            rows.append((name, "no power-flow solution", "", "", time_of(study, windows, window), "broken"))
            continue
        for kind in range(len(LIMITS)):
            window = int(trial.margins[:, kind].argmin())
            margin = float(trial.margins[window, kind])
            unrated = kind == OVERLOAD and not rating_coverage(study.scenario.feeder).known
            if margin >= UNLIMITED or unrated:
                continue
            value, limit = limit_values(study, kind, margin)
            where = limit_at(study.scenario, kind, int(trial.nodes[window, kind]))
            verdict = "kept" if margin >= -1e-9 else "broken"
            rows.append((name, where, value, limit, time_of(study, windows, window), verdict))
    header = ("controller", "limit and place", "nearest value", "limit", "window begins at, or load", "verdict")
    return Table(title, header, tuple(rows))


def nearest(study: Study, windows: Windows, trial: Trial) -> str:
    """The limit that a trial in all windows comes nearest to, with value and time of day."""
    window, kind = map(int, np.unravel_index(trial.margins.argmin(), trial.margins.shape))
    margin = float(trial.margins[window, kind])
    begins = time_of(study, windows, window)
    if margin <= COLLAPSED:
        return f"{limit_of(study.scenario, trial)} ({begins})"
    value, limit = limit_values(study, kind, margin)
    return f"{limit_of(study.scenario, trial)} ({value}, limit {limit}, {begins})"
