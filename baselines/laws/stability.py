"""How large the gains of the linear droop may be: the closed loop of the law and the linearised feeder.

With LinDistFlow (Baran and Wu 1989) at the agents' buses, R and X in p.u. per MW and Mvar, d the data centres:

    V_t     = V_0 + X q_t - R p_t                                        q injected, p drawn
    q_{t+1} = q_t - k_q dt (V_t - 1)
    p_{t+1} = p_ref + k_p (V_t - 1) + alpha S_t                          S: the backlog
    S_{t+1} = S_t + (p_ref - p_{t+1}) dt

The errors follow x_{t+1} = M x_t with x = (q, p, S), and the loop is stable where the spectral radius of M is at most
1:

    k_p = 0             M = I - k_q dt X         stable where k_q dt lambda_max(X) < 2
    k_q = alpha = 0     M = -k_p R_dd            stable where k_p rho(R_dd) < 1
    k_q = 0, alpha      as the backlog is fed back, only where k_p rho(R_dd) < 1 - alpha dt / 2   (alpha dt <= 2)

and both axes together by the eigenvalues. A site cannot serve more than waits. If k_p is 0, no work is delayed again,
and alpha counts as 1 / dt at most. The first bound is that of integrating local volt-var control [1]_. The
second is the bound of [2]_ for a proportional law on p, whose measurement is a step old. The third and the joint matrix
are derived here.

The model leaves out:

- limits, which bound an oscillation but do not end it;
- work that has not arrived, so an oscillation of the clock shows only while there is a backlog;
- the steeper voltage of the exact power flow. On toy6 the reactive bound holds to 2 %, the active one is 5 to 10 %
  lower. On ieee33-weak the clock swings from 10 or 20 % below the bound on, at its low voltages;
- clock laws other than the linear one, the one-step memory, and the growth of alpha, which adds to alpha;
- a delay of the measurement, which tightens the bounds.

A direction that no voltage sees (two agents behind the same impedance) has the eigenvalue 1: it does not grow.

References
----------
.. [1] H. Zhu and H. J. Liu, "Fast local voltage control under limited reactive power: optimality and stability
   analysis", IEEE Trans. Power Systems 31(5), 2016.
.. [2] M. Farivar, L. Chen and S. Low, "Equilibrium and dynamics of local voltage control in distribution systems",
   CDC 2013.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dcgrid_env import DcgridVectorEnv, Scenario, action_layout, sensitivity_between_agents
from dcgrid_env.baselines.laws.droop import Droop
from dcgrid_env.baselines.parameter_checks import require_non_negative

PLACEMENTS = 20
"""Seeds whose placements are looked at where a scenario draws them."""
_ROUNDING = 1e-9


def spectral_radius(
    scenario: Scenario,
    buses: Sequence[int | str],
    k_p_mw_per_pu: float,
    k_q_mvar_per_pu_s: float,
    *,
    alpha_per_s: float = 0.0,
    datacenters: bool = True,
) -> float:
    """Largest magnitude of an eigenvalue of the closed loop; above 1 the gains oscillate or run away.

    Parameters
    ----------
    scenario
        Gives the feeder, dt and the number of data centres.
    buses
        Buses of the agents, data centres first, see :func:`placements`.
    k_p_mw_per_pu, k_q_mvar_per_pu_s, alpha_per_s, datacenters
        Gains and memory, see :class:`Droop`.

    Raises
    ------
    ValueError
        For a gain that is negative or not finite, or another number of buses than of agents.
    """
    require_non_negative(
        "stability", k_p_mw_per_pu=k_p_mw_per_pu, k_q_mvar_per_pu_s=k_q_mvar_per_pu_s, alpha_per_s=alpha_per_s
    )
    if len(buses) != scenario.n_agents:
        raise ValueError(f"stability: {len(buses)} buses; {scenario.name} has {scenario.n_agents} agents")
    r, x = _impedances(scenario, [buses], datacenters)
    gains = (k_p_mw_per_pu, k_q_mvar_per_pu_s, alpha_per_s)
    return float(_radii(r, x, scenario.datacenters.count if datacenters else 0, scenario.dt_s, *gains).max())


def _impedances(
    scenario: Scenario, where: Sequence[Sequence[int | str]], datacenters: bool
) -> tuple[np.ndarray, np.ndarray]:
    """R and X between the agents that act, for each placement, (placement, n, n)."""
    index = scenario.feeder.index
    acting = np.flatnonzero(action_layout(scenario).reactive >= 0)  # equipment of the feeder gives no reactive power
    acting = acting[0 if datacenters else scenario.datacenters.count :]
    positions = np.array([[index(bus) for bus in buses] for buses in where], dtype=np.intp)
    r, x = sensitivity_between_agents(scenario, positions)
    return r[:, acting[:, None], acting], x[:, acting[:, None], acting]


def _radii(
    r: np.ndarray, x: np.ndarray, n_dc: int, dt_s: float, k_p: float, k_q: float, alpha_per_s: float
) -> np.ndarray:
    """Spectral radius of each placement's closed loop, (placement,)."""
    n_row, n, _ = x.shape
    sees_v = np.concatenate((x, -r[..., :n_dc], np.zeros((n_row, n, n_dc))), axis=-1)  # V - V_0 from (q, p, S)
    of_q, _, of_s = np.split(np.eye(n + 2 * n_dc), [n, n + n_dc])
    next_q = of_q - k_q * dt_s * sees_v
    next_p = k_p * sees_v[:, :n_dc] + (alpha_per_s if k_p > 0.0 else min(alpha_per_s, 1.0 / dt_s)) * of_s
    next_s = of_s - dt_s * next_p
    # A state that nothing moves or that nothing reads would only add an eigenvalue 1 or 0.
    keep = np.repeat([k_q > 0, k_p > 0 or alpha_per_s > 0, alpha_per_s > 0], [n, n_dc, n_dc])
    if not keep.any():
        return np.zeros(n_row)
    loop = np.concatenate((next_q, next_p, next_s), axis=1)[:, keep][:, :, keep]
    return np.abs(np.linalg.eigvals(loop)).max(axis=-1)


def placements(scenario: Scenario, n: int = PLACEMENTS) -> list[tuple[int | str, ...]]:
    """Buses of the agents in the episodes of seeds 0 .. n - 1 of the scenario's split; one where none are drawn."""
    n_env = 1 if scenario.datacenters.buses is not None or not scenario.datacenters.count else n
    env = DcgridVectorEnv(n_env, scenario)
    _, info = env.reset(seed=list(range(n_env)))
    env.close()
    return list(zip(*(info[f"bus_{agent}"].tolist() for agent in scenario.agents), strict=True))


class ClosedLoops:
    """The linearised feeder of scenarios at the agents' buses, from which gains have their spectral radius.

    Parameters
    ----------
    scenarios
        Each is taken at its :func:`placements`; with random feeders, on the feeders of the first ``n`` seeds.
    n
        Seeds whose placements are looked at.
    """

    def __init__(self, scenarios: Sequence[Scenario], n: int = PLACEMENTS):
        members = [member for scenario in scenarios for member, _ in scenario.members(range(n))]
        self._loops = [(member, *_impedances(member, placements(member, n), True)) for member in members]

    def largest_radius(self, droop: Droop) -> float:
        """Largest spectral radius of a droop's gains over scenarios and placements."""
        gains = (droop.k_p_mw_per_pu, droop.k_q_mvar_per_pu_s, droop.alpha_per_s)
        radii = []
        for scenario, r, x in self._loops:
            left_out = 0 if droop.datacenters else scenario.datacenters.count
            acting = np.s_[:, left_out:, left_out:]
            n_dc = scenario.datacenters.count - left_out
            radii.append(_radii(r[acting], x[acting], n_dc, scenario.dt_s, *gains).max())
        return float(max(radii))


def worst_radius(scenario: Scenario, droop: Droop, n: int = PLACEMENTS) -> float:
    """Largest spectral radius of a droop's gains over :func:`placements`."""
    return ClosedLoops([scenario], n).largest_radius(droop)


def is_stable(radius: float) -> bool:
    """Whether errors do not grow, rounding aside."""
    return radius <= 1.0 + _ROUNDING


def largest_stable(
    scenario: Scenario,
    *,
    k_p_mw_per_pu: float | None = None,
    k_q_mvar_per_pu_s: float | None = None,
    alpha_per_s: float = 0.0,
    datacenters: bool = True,
    n: int = PLACEMENTS,
) -> float:
    """The largest stable value of the gain that is left out, given the other, over all of :func:`placements`.

    Found by bisection to 1e-6 of the value; 0 where the other gain is too large already, infinite where none is too
    large (no agent that it moves).

    Raises
    ------
    ValueError
        Unless exactly one of the two gains is given.
    """
    if (k_p_mw_per_pu is None) == (k_q_mvar_per_pu_s is None):
        raise ValueError("stability: give one of k_p_mw_per_pu and k_q_mvar_per_pu_s; the other is looked for")
    gains = {"k_p_mw_per_pu": k_p_mw_per_pu, "k_q_mvar_per_pu_s": k_q_mvar_per_pu_s, "alpha_per_s": alpha_per_s}
    require_non_negative("stability", **{name: value for name, value in gains.items() if value is not None})
    r, x = _impedances(scenario, placements(scenario, n), datacenters)
    n_dc = scenario.datacenters.count if datacenters else 0

    def stable(gain: float) -> bool:
        k_p = gain if k_p_mw_per_pu is None else k_p_mw_per_pu
        k_q = gain if k_q_mvar_per_pu_s is None else k_q_mvar_per_pu_s
        return is_stable(float(_radii(r, x, n_dc, scenario.dt_s, k_p, k_q, alpha_per_s).max()))

    if not stable(0.0):
        return 0.0
    low, high = 0.0, 1e-3
    while stable(high):
        low, high = high, 2.0 * high
        if high > 1e9:
            return float("inf")
    while high - low > 1e-6 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def warning(scenario: Scenario, controller: object) -> str | None:
    """One line for a droop whose gains exceed the bound on a scenario; None for one within it and for anything else."""
    if not isinstance(controller, Droop):
        return None
    radius = worst_radius(scenario, controller)
    if is_stable(radius):
        return None
    return (
        f"droop's gains are beyond the linear stability bound on {scenario.name}: k_p = {controller.k_p_mw_per_pu:g} "
        f"MW/p.u., k_q = {controller.k_q_mvar_per_pu_s:g} Mvar/p.u. s, alpha = {controller.alpha_per_s:g} /s give a "
        f"spectral radius of {radius:.3f} > 1; expect oscillation"
    )
