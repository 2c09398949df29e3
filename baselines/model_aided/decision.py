"""An agent's clock and reactive power, which are best for its estimate of all voltages.

The clock: work is served as long as a kW less relieves the expected cost by less than its waiting costs,

    sum_k -c'(V^_k + D_ik y) R_ik < waiting              y: kW served less than all that is there

The reactive setpoint, if all agents move alike: find t with

    sum_k c'(V^_k + t O_k) X'_ik q_i + effort'(u + t) + hold (u + t - u*) = 0

c' is the slope of the expected cost (``expected_cost``). X'_ik is the effect of the agent's reactive power on bus k
once the others have answered it (``answers``). u is its setpoint as a share of its limit q_i. O_k is the effect of all
agents on bus k when each moves by its whole limit, times the agent's damping (``damping``). The gradient is the agent's
own; the voltages it is taken at are those after all have moved as it does. Without that each agent would do all that is
missing, and together they would overshoot by the number of agents. Both left sides rise, so that a bracket closes on
the zero (Illinois method: M. Dowell and P. Jarratt, BIT 11, 1971); steps by the local slope alone (Newton) oscillate,
as the cost is almost piecewise linear where voltages are known well.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.baselines.model_aided.expected_cost import VoltagePrice
from dcgrid_env.baselines.model_aided.knowledge import Commissioned, Site, between


class DecisionInputs(NamedTuple):
    """What each agent goes by; m rows, n agents, data centres first."""

    v_pu: np.ndarray
    """Own voltage as measured, (m, n)."""
    then_kw: np.ndarray
    """Own draw at that time, (m, n)."""
    then_kvar: np.ndarray
    """Own injection at that time, (m, n)."""
    kvar: np.ndarray
    """Own injection now, (m, n)."""
    p_kw: np.ndarray
    """Draw of the coming second if all work is served that is there, (m, n)."""
    span_kw: np.ndarray
    """By how much less the lowest clock would draw, (m, n_dc); (m, 0) where no clock is to be decided."""
    rest_kvar: np.ndarray
    """u*, (m, n)."""


class Decision(NamedTuple):
    """What is best, and the figures that led to it."""

    share: np.ndarray
    """Reactive setpoint as a share of the limit at zero active power, (m, n)."""
    cut_kw: np.ndarray
    """How much less than all work to serve, (m, n_dc)."""
    slope: np.ndarray
    """Derivative of the expected cost by ``share`` at the setpoint now, without the price of effort, (m, n)."""
    relief: np.ndarray
    """What the first kW less relieves the expected cost by, (m, n_dc)."""
    surprise_pu: np.ndarray
    """E_i less what is expected of it, (m, n)."""


def decide(site: Site, known: Commissioned, inputs: DecisionInputs) -> Decision:
    """Decide for all agents of all rows; ``known`` is of one placement or has one a row."""
    # Both bring the compiler with them, so not on import.
    from dcgrid_env.baselines.model_aided import response_kernels
    from dcgrid_env.core.threads import over_rows

    kernel: Any = response_kernels.decide
    price, scale = VoltagePrice.from_scenario(site.scenario), site.kvar_share
    e_own = own_error(known, inputs.v_pu, inputs.then_kw, inputs.then_kvar)
    key = np.broadcast_to(known.key, (len(e_own), *known.key.shape[1:]))
    level, weight = between(np.where(site.scheduled, inputs.then_kw, e_own), key)
    n_row, n = e_own.shape
    n_dc = inputs.span_kw.shape[1]
    done = Decision(*(np.zeros((n_row, wide)) for wide in (n, n_dc, n, n_dc, n)))
    arguments = [
        np.ascontiguousarray(values)
        for values in (
            known.hold, known.alike, known.base_pu, known.own_base_pu, known.gain, known.inverse_spread,
            known.by_all, known.by_q, known.by_own, known.by_p, known.by_draw, known.waiting, level, weight, e_own,
            inputs.kvar - known.origin_kvar, inputs.p_kw - known.mean_kw, inputs.span_kw, inputs.p_kw,
            inputs.kvar / scale, inputs.rest_kvar / scale, site.s_rated_kva, site.q_scale_kvar, site.effort,
        )
    ]  # fmt: skip

    def part(first: int, last: int) -> int:
        return kernel(first, last, price.voltage, price.violation, price.band_pu, *arguments, *done)

    over_rows(part, n_row)
    return done


def own_error(known: Commissioned, v_pu: np.ndarray, p_kw: np.ndarray, q_kvar: np.ndarray) -> np.ndarray:
    """E_i: the own voltage with the own part taken out, p.u., (m, n)."""
    own_effect = known.own_by_q * (q_kvar - known.origin_kvar) - known.own_by_draw * (p_kw - known.mean_kw)
    return v_pu - own_effect
