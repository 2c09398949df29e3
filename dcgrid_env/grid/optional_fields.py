"""The fields that a balanced feeder has only where its tables say something: shunts, transformer ratios, ratings.

A column that holds its default alone, or nothing, gives None: such a feeder is the one that it is without the column.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.grid.network import Network, summed_at_nodes

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


def as_column(values: FloatArray | None) -> tuple[float, ...]:
    """Values of an optional field as a column of a table, empty where it is None."""
    return () if values is None else tuple(values.tolist())


def _filled(column: Sequence[float], rows: NDArray[np.intp], missing: float) -> FloatArray | None:
    """Rows of a column with ``missing`` in the place of NaN; None for an empty one."""
    if not column:
        return None
    values = np.asarray(column, dtype=np.float64)[rows]
    return np.where(np.isnan(values), missing, values)
