"""The paper's claims as rows: what it says, what comes out here, whether it holds, and one line why.

Every figure comes from the records of the runs; a verdict is "holds", "partly" or "does not", and the reason goes with
it.
"""

from __future__ import annotations

from collections.abc import Callable

from dcgrid_env.apps.reproduction import lever_claims, table_claims
from dcgrid_env.apps.reproduction.verdict import Records, Row


def claims(records: Records) -> list[Row]:
    """A row for each claim whose parts of the study are among the records: claim, paper, ours, verdict, reason."""
    return [make(records) for make, parts in _CLAIMS.items() if records.keys() >= parts]


_CLAIMS: dict[Callable[[Records], Row], set[str]] = {
    table_claims.mean_within: {"table_one"},
    table_claims.trend: {"table_one"},
    table_claims.rising: {"comparison"},
    table_claims.five_sites: {"table_one", "comparison"},
    table_claims.gain: {"gains"},
    table_claims.inside: {"table_one", "comparison"},
    table_claims.clock_at_five: {"table_one"},
    table_claims.delay: {"table_one"},
    table_claims.flat_delay: {"table_one"},
    table_claims.linear: {"grids"},
    lever_claims.far: {"inverters"},
    lever_claims.bus_outside: {"bus_thirteen"},
    lever_claims.bus_why: {"bus_thirteen"},
    lever_claims.interval: {"intervals"},
    lever_claims.load_change: {"step"},
}
"""Each claim and the parts of the study that it is made of."""
