"""The paper's claims as rows: what it says, what comes out here, whether it holds, and one line why.

Every figure comes from the records of the runs; a verdict is "holds", "partly" or "does not", and the reason goes with
it.
"""

from __future__ import annotations

from dcgrid_env.baselines.reproduction import lever_claims, table_claims
from dcgrid_env.baselines.reproduction.verdict import Records, Row


def claims(records: Records) -> list[Row]:
    """A row for each claim: claim, paper, ours, verdict, reason."""
    return [make(records) for make in _CLAIMS]


_CLAIMS = (
    table_claims.mean_within,
    table_claims.rising,
    table_claims.five_sites,
    table_claims.gain,
    table_claims.inside,
    table_claims.delay,
    table_claims.linear,
    lever_claims.far,
    lever_claims.active,
    lever_claims.bus_outside,
    lever_claims.bus_why,
    lever_claims.interval,
    lever_claims.sign,
)
