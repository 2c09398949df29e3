"""The fields that a balanced feeder has only where its tables say something: shunts, transformer ratios, ratings.

A column that holds its default alone, or nothing, gives None: such a feeder is the one that it is without the column.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.grid.network import Network, summed_at_nodes
from dcgrid_env.grid.topology import FeederError

FloatArray = NDArray[np.float64]


def optional_fields(network: Network, order: NDArray[np.intp], branch: NDArray[np.intp]) -> dict[str, Any]:
    """The optional fields of ``Feeder`` by name, read-only arrays or None.

    Parameters
    ----------
    network
        Checked tables of a balanced grid.
    order, branch
        Row of each bus among the nodes and of each branch among the lines, shapes (n_bus,) and (n_branch,).
    """
    node, line, shunt = network.node, network.line, network.shunt
    fields: dict[str, FloatArray | None] = {
        field: summed_at_nodes(node, shunt.bus, values)[order] if values else None
        for field, values in (("shunt_kw", shunt.shunt_kw), ("shunt_kvar", shunt.shunt_kvar))
    }
    fields["voltage_ratio"] = _filled(node.voltage_ratio, order, 1.0)
    fields["bus_base_kv"] = _filled(node.base_kv, order, float(network.source.base_kv[0]))
    fields["rating_a"] = _filled(line.rating_a, branch, np.nan)
    defaults = {"voltage_ratio": 1.0, "bus_base_kv": network.source.base_kv[0], "rating_a": np.nan}
    for field, values in fields.items():
        if values is not None and np.array_equal(values, np.full_like(values, defaults.get(field, 0.0)), True):
            fields[field] = None
        elif values is not None:
            values.flags.writeable = False
    return fields


def check_optional_fields(feeder: Any) -> None:
    """Raise FeederError for an optional field of a wrong shape or with a figure that no feeder has, naming it."""
    n_bus = len(feeder.bus_ids)
    for field, n in (
        ("shunt_kw", n_bus), ("shunt_kvar", n_bus), ("voltage_ratio", n_bus), ("bus_base_kv", n_bus),
        ("rating_a", len(feeder.r_ohm)),
    ):  # fmt: skip
        values = getattr(feeder, field)
        if values is None:
            continue
        if np.shape(values) != (n,):
            raise FeederError(
                f"feeder {feeder.name!r}: {field} has shape {np.shape(values)}; give one figure for each of {n}"
            )
        known = ~np.isnan(values) if field == "rating_a" else np.ones(n, bool)
        wrong = (
            known & ~np.isfinite(values) if field.startswith("shunt") else known & ~((values > 0) & (values < np.inf))
        )
        if wrong.any():
            i = int(np.flatnonzero(wrong)[0])
            subject = (
                f"branch to bus {feeder.bus_ids[feeder.to_bus[i]]}"
                if field == "rating_a"
                else f"bus {feeder.bus_ids[i]}"
            )
            wanted = "a finite number" if field.startswith("shunt") else "a number > 0"
            raise FeederError(f"feeder {feeder.name!r}: {subject}: {field} is {values[i]}; give {wanted}")
    loops = len(feeder.r_ohm) - n_bus + 1
    ends = () if feeder.loop_ends is None else np.shape(feeder.loop_ends)
    if ends != ((loops, 2) if loops else ()):
        raise FeederError(
            f"feeder {feeder.name!r}: loop_ends has shape {ends}; give the two buses of each of the {loops} branches "
            f"after the first {n_bus - 1}, or None"
        )
    if feeder.voltage_ratio is not None and feeder.voltage_ratio[0] != 1.0:
        raise FeederError(
            f"feeder {feeder.name!r}: voltage_ratio of the substation is {feeder.voltage_ratio[0]}; it must be 1"
        )


def as_column(values: FloatArray | None) -> tuple[float, ...]:
    """Values of an optional field as a column of a table, empty where it is None."""
    return () if values is None else tuple(values.tolist())


def _filled(column: Sequence[float], rows: NDArray[np.intp], missing: float) -> FloatArray | None:
    """Rows of a column with ``missing`` in the place of NaN; None for an empty one."""
    if not column:
        return None
    values = np.asarray(column, dtype=np.float64)[rows]
    return np.where(np.isnan(values), missing, values)
