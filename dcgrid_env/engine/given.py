"""What of an episode may be set from outside."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Given(NamedTuple):
    """What of an episode is set from outside rather than drawn; None is drawn."""

    buses: np.ndarray | None = None
    """Position in ``bus_ids`` of each agent's bus, (lane, n_agent)."""
    begin_h: np.ndarray | None = None
    """Time of day at t = 0, h in [0, 24), (lane,), of a scenario that follows the day."""
