"""Local policy that is monotone in the agent's voltage and has a bounded slope, whatever it learns.

Each output, a change of reactive power or of the clock (``interface``), has a separate head:

    output = offset(c) - slope psi(z, c)          psi = a_0 (z - b_0) + sum_h a_h t_h tanh((z - b_h) / t_h)

with z the voltage deviation in bands and c the other inputs of the head. The weights a(c) are the first entries of a
softmax. They are therefore positive with a sum below 1, and the derivative of psi by z is between 0 and 1. A lower
voltage never means less reactive power or a faster clock. b, and for a clock the offset, depend on c and change the
target voltage, not the gain.

Stability. If c does not depend on q, the reactive power of all agents changes by q' = q - S psi(X q + w), with S the
diagonal matrix of slopes. Let Psi be the sum over agents of slope times the integral of psi by z. Psi is convex because
psi is monotone, and its second derivatives are at most S. With u = S psi, a step changes Psi by at most
-u'X u + 0.5 u'X S X u. Psi therefore decreases at every step if

    lambda_max(S^1/2 X S^1/2) < 2

For equal slopes this is the bound of the integrating droop (``baselines.stability``). The argument assumes constant c
and no agent at its reactive limit, where q does not change.

References for monotone networks with such a bound: W. Cui, J. Li and B. Zhang, "Decentralized safe reinforcement
learning for inverter-based voltage control", arXiv 2110.01126; Y. Shi, G. Qu, S. Low, A. Anandkumar and A. Wierman,
"Stability constrained reinforcement learning for real-time voltage control", arXiv 2109.14854 and 2209.07669.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from dcgrid_env.agents.policy.neural_network import Network, PolicyError, figures
from dcgrid_env.core.arrays import Array, namespace

UNITS = 6
"""Number of tanh units in psi, in addition to the linear one."""
WIDTH = 2 * UNITS + 4
"""Outputs of a head's context network: UNITS + 2 logits (one for the remainder of 1), UNITS + 1 centres, offset."""


class Head(NamedTuple):
    """Head of one output."""

    context: Network
    """Network from the head's inputs to ``WIDTH`` outputs."""
    columns: np.ndarray
    """Positions of the head's inputs in the observation, int, (n,)."""
    widths: np.ndarray
    """t_h, bands, (UNITS,)."""
    slope: float
    """Maximum slope, units of the output per voltage band."""
    offset: bool
    """Whether the head has an offset: a clock has one; reactive power has none, because it would drift."""


def head_output(z: Array, context: Array, widths: Array, slope: float, offset: bool) -> Array:
    """Return a head's output for deviations ``z`` (...) and context outputs (..., WIDTH); NumPy or torch."""
    xp = namespace(z)
    share = xp.exp(context[..., : UNITS + 2].clip(-15.0, 15.0))
    share = share / share.sum(-1)[..., None]
    apart = z[..., None] - context[..., UNITS + 2 : -1]
    bent = widths * xp.tanh(apart[..., 1:] / widths)
    psi = share[..., 0] * apart[..., 0] + (share[..., 1:-1] * bent).sum(-1)
    return context[..., -1] - slope * psi if offset else -slope * psi


class MonotoneNetwork:
    """Network of monotone heads, one for each output.

    Parameters
    ----------
    heads
        Heads in the order of the outputs.
    n_in
        Number of entries in the observation.
    v_at
        Position of the voltage deviation in the observation.

    Raises
    ------
    PolicyError
        If a head does not fit.
    """

    family: ClassVar[str] = "monotone"

    def __init__(self, heads: Sequence[Head], n_in: int, v_at: int = 0):
        if not len(heads):
            raise PolicyError("heads is empty; give at least one")
        if not 0 <= v_at < n_in:
            raise PolicyError(f"v_at is {v_at}; give one of 0 .. {n_in - 1}")
        for i, head in enumerate(heads):
            columns = head.columns
            if columns.ndim != 1 or not len(columns) or columns.min() < 0 or columns.max() >= n_in or v_at in columns:
                raise PolicyError(
                    f"head {i}: columns are {columns.tolist()}; give some of 0 .. {n_in - 1} without {v_at}"
                )
            if (head.context.n_in, head.context.n_out) != (len(columns), WIDTH):
                raise PolicyError(
                    f"head {i}: its context network takes {head.context.n_in} figures and gives {head.context.n_out}; "
                    f"it must be {len(columns)} and {WIDTH}"
                )
            if head.widths.shape != (UNITS,) or not (head.widths > 0).all() or not 0 < head.slope < np.inf:
                raise PolicyError(f"head {i}: give {UNITS} widths and a slope above 0")
        self.heads, self.n_in, self.v_at = tuple(heads), n_in, v_at

    @property
    def n_out(self) -> int:
        """Number of outputs."""
        return len(self.heads)

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Return the output, float32, (..., n_out), for an observation (..., n_in)."""
        x = np.asarray(observation, dtype=np.float32)
        outputs = [
            head_output(x[..., self.v_at], h.context(x[..., h.columns]), h.widths, h.slope, h.offset)
            for h in self.heads
        ]
        return np.stack(outputs, axis=-1)

    def arrays(self) -> dict[str, np.ndarray]:
        """``widths0, columns0`` and the context network's arrays, ``context0.w0`` .., for each head."""
        arrays: dict[str, np.ndarray] = {}
        for i, head in enumerate(self.heads):
            arrays |= {f"widths{i}": head.widths, f"columns{i}": head.columns.astype(np.float32)}
            arrays |= {f"context{i}.{name}": array for name, array in head.context.arrays().items()}
        return arrays

    def settings(self) -> dict[str, Any]:
        """Width, position of the voltage, and slope, offset and context settings of each head."""
        heads = [{"slope": h.slope, "offset": h.offset, "context": h.context.settings()} for h in self.heads]
        return {"n_in": self.n_in, "v_at": self.v_at, "heads": heads}

    @classmethod
    def read(cls, arrays: Mapping[str, np.ndarray], settings: Mapping[str, Any]) -> Self:
        """Create the network from arrays and settings."""
        heads = []
        for i, head in enumerate(settings["heads"]):
            of = f"context{i}."
            context_arrays = {name.removeprefix(of): array for name, array in arrays.items() if name.startswith(of)}
            columns, widths = (figures(name, arrays[name], 1) for name in (f"columns{i}", f"widths{i}"))
            context = Network.read(context_arrays, head["context"])
            slope, offset = float(head["slope"]), bool(head["offset"])
            heads.append(Head(context, columns.astype(np.int64), widths, slope, offset))
        return cls(heads, int(settings["n_in"]), int(settings["v_at"]))
