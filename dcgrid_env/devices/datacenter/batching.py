"""Batch size: larger batches take less energy for the same work, and a request waits longer for its first token.

With b requests in a batch and b0 in that of the trace, work takes this share of the energy that it takes there,

    e(b) = 1 - c + c b0 / b                  c: what a batch takes whatever its size, as a share, at b0

since the weights of a model are read once for a whole batch. The clock law is given the work by its energy, so that at
b > b0 a site draws less at the same rate, and can do more at the same power. A request waits for its batch

    w(b) = gather_s (b / b0 - 1)             longer than in the trace, less where b < b0

which is added to its time to first token and end to end, and charged (``batch_weight``) for b > b0.

Sizes of 8 to 512 are those of OpenG2G's examples (https://github.com/gpu2grid/openg2g), where larger batches likewise
raise throughput and latency. There the power of a GPU that is always full rises with b; here the rate is given, and
so less of the GPUs' time is needed. c is fitted: from 8 to 512 the energy of a token falls to a quarter, between the
factors of 3 and 5 that arXiv 2601.22076 names for the use of a GPU. b0 and ``gather_s`` are a choice. Measured points
of one model and GPU give their own c (:meth:`Batching.fitted`): 0.43 for an 8B model on one H100, 0.53 for a 70B model
on four.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dcgrid_env.core.arrays import Array, positive_part
from dcgrid_env.core.checked import number, refuse, settle
from dcgrid_env.core.metric import Metric, cost_metric
from dcgrid_env.devices.datacenter.datacenter import DataCenterState
from dcgrid_env.devices.datacenter.site_features import FeatureInputs, Load, PassiveFeature, SiteState
from dcgrid_env.devices.device import Channel, CostTerm, Field, Work
from dcgrid_env.devices.ratings import DataCenterParams


@dataclass(frozen=True, kw_only=True)
class Batching:
    """Batch sizes that agents can select for the sites; plain form: a mapping of these fields."""

    lowest: float = number(1.0, 65536.0, default=8.0)
    """Smallest batch, requests."""
    highest: float = number(1.0, 65536.0, default=512.0)
    """Largest batch, requests."""
    reference: float = number(1.0, 65536.0, default=64.0)
    """Batch of the trace, requests; the initial setpoint."""
    batch_energy_share: float = number(0.0, 0.99, default=0.3)
    """Share of a batch's energy that does not depend on its size, at the reference."""
    gather_s: float = number(0.0, 3600.0, default=0.1)
    """Time that a request waits for its batch at the reference, s."""
    batch_weight: float = number(0.0, 1e9, default=0.3)
    """Weight of the cost term ``gathering``: seconds that the work served in a second waited longer than in the trace,
    as a share of the rating."""

    def __post_init__(self) -> None:
        settle(self)
        if not self.lowest < self.highest:
            raise refuse(self, "lowest", f"give less than highest = {self.highest:g}")
        if not self.lowest <= self.reference <= self.highest:
            raise refuse(self, "reference", f"give a size from {self.lowest:g} to {self.highest:g}")

    @classmethod
    def fitted(cls, batch: ArrayLike, energy: ArrayLike, **fields: float) -> Batching:
        """Batches whose energy is fitted to measurements, by least squares of the energies' ratios.

        Parameters
        ----------
        batch
            Batch sizes, at least two different ones, shape (n,).
        energy
            Energy of a token, a request or other work at each, in one unit, shape (n,).
        **fields
            Other fields, such as ``reference``.

        Raises
        ------
        ValueError
            For fewer sizes, an invalid one, or an energy that does not fall as batches grow.
        """
        size, measured = np.asarray(batch, np.float64), np.asarray(energy, np.float64)
        if size.ndim != 1 or size.shape != measured.shape or len(np.unique(size)) < 2:
            shapes = f"{size.shape} sizes and {measured.shape} energies"
            raise ValueError(f"Batching.fitted: {shapes}; give two or more of each")
        if not (np.isfinite([size, measured]).all() and (size > 0).all() and (measured > 0).all()):
            raise ValueError("Batching.fitted: a size or an energy is not a positive number; remove it")
        slope, fixed = np.polyfit(1.0 / size, measured, 1, w=1.0 / measured)  # errors as shares of the energies
        share = slope / (slope + fixed * cls(**fields).reference)
        if not 0.0 <= share < 0.99 or fixed <= 0.0:
            raise ValueError("Batching.fitted: energies do not fall towards a limit as batches grow; check the sizes")
        return cls(**{**fields, "batch_energy_share": float(share)})


class BatchState(NamedTuple):
    """State of the batches, (row, slot) each."""

    batch: Array
    """Requests in a batch."""
    batch_wait_s: Array
    """Additional wait of a request for its batch, compared with the trace, s."""
    gathered_kws: Array
    """Work served in the step times its additional wait, kW s; 0 below the reference."""


METRICS = (
    cost_metric("gathering", "cost of gathering batches"),
    Metric("batch_mean", "mean batch", "requests", 1, "neither", "mean setpoint of the batch size", "mean",
        tables=("run",)),
)  # fmt: skip
"""Metrics of sites that batch their work."""


@dataclass(frozen=True)
class BatchedSites(PassiveFeature):
    """Sites with these batches."""

    rule: Batching
    boost_share: float = 1.0
    """Highest draw of a site as a share of its rating."""

    amounts: ClassVar[tuple[str, ...]] = ("gathered_kws",)
    accounts_last: ClassVar[bool] = True

    def channels(self, params: DataCenterParams) -> tuple[Channel, ...]:
        """The batch size by its logarithm, so that each doubling is as far."""
        rule, one = self.rule, np.ones(len(params.p_rated_kw))
        low, high, rest = (float(np.log2(size)) * one for size in (rule.lowest, rule.highest, rule.reference))
        return (Channel("batch", "log2 of requests", low, high, rest=rest),)

    def fields(self, params: DataCenterParams, horizon: int, dt_s: float) -> tuple[Field, ...]:
        """The batch size now."""
        one = np.ones(len(params.p_rated_kw))
        return (Field("batch", "share of the largest", 0.0, 1.0, one * self.rule.highest),)

    def cost_terms(self, params: DataCenterParams, horizon: int, dt_s: float) -> tuple[CostTerm, ...]:
        """What requests wait for their batches."""
        rule, rated = self.rule, params.p_rated_kw
        idle_share = float((params.p_idle_kw / rated).min(initial=1.0))
        served = max(1.0, self.boost_share) - idle_share
        largest = served * self._longest_s / max(self._energy(np.log2(rule.highest)), 1e-2)
        of_all = float(rated.sum()) or 1.0
        return (CostTerm("gathering", "gathered_kws", rated, of_all, largest, weight=rule.batch_weight),)

    @property
    def _longest_s(self) -> float:
        return self.rule.gather_s * (self.rule.highest / self.rule.reference - 1.0)

    def _energy(self, size: Array) -> Array:
        """e(b) for log2 of b."""
        c = self.rule.batch_energy_share
        return 1.0 - c + c * self.rule.reference * 2.0 ** (-size)

    def initial(self, params: DataCenterParams, zero: Array) -> BatchState:
        """Batches of the trace."""
        return BatchState(zero + self.rule.reference, zero, zero)

    def admit(
        self,
        params: DataCenterParams,
        state: SiteState,
        feature_state: BatchState,
        load: Load,
        setpoints: tuple[Array, ...],
        work: Work,
        dt_s: float,
    ) -> tuple[BatchState, Load]:
        """Set the batch, see ``SiteFeature.admit``."""
        batch = 2.0 ** setpoints[0]
        wait_s = self.rule.gather_s * (batch / self.rule.reference - 1.0)
        return BatchState(batch, wait_s, feature_state.gathered_kws), load._replace(
            energy_share=self._energy(setpoints[0])
        )

    def step(
        self,
        params: DataCenterParams,
        feature_state: BatchState,
        site: DataCenterState,
        p_kw: Array,
        setpoints: tuple[Array, ...],
        inputs: FeatureInputs,
        dt_s: float,
    ) -> tuple[BatchState, DataCenterState, Array]:
        """Account for the wait of what was served, see ``SiteFeature.step``."""
        return (
            feature_state._replace(gathered_kws=site.served_kw * positive_part(feature_state.batch_wait_s)),
            site,
            p_kw,
        )

    def observe(self, params: DataCenterParams, feature_state: BatchState) -> tuple[Array, ...]:
        """Raw figures of ``fields``."""
        return (feature_state.batch,)

    def amount(self, name: str, params: DataCenterParams, feature_state: BatchState) -> Array:
        """Return the amount that the term of ``cost_terms`` charges."""
        return feature_state.gathered_kws

    def totals(self, feature_state: BatchState) -> dict[str, Array]:
        """Return an empty dictionary, because batching has no totals over slots."""
        return {}

    def metrics(
        self, params: DataCenterParams, history: SiteState, feature_state: BatchState, dt_s: float
    ) -> dict[str, float]:
        """Figures of an episode, see ``core.metric``."""
        return {"batch_mean": feature_state.batch[1:].mean() if feature_state.batch.size else 0.0}
