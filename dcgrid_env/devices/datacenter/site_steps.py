"""One interval of a group of sites: work as features admit it, what is served of it, and what features then do."""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env.core.arrays import Array, namespace
from dcgrid_env.devices.datacenter.clock_law import Dvfs, work_classes_of
from dcgrid_env.devices.datacenter.datacenter import DataCenterState, DataCenterStep, serve_arrived, step
from dcgrid_env.devices.datacenter.site_features import FeatureInputs, Load, SiteState
from dcgrid_env.devices.datacenter.site_work import arriving, idle_draw, top_power
from dcgrid_env.devices.device import Work
from dcgrid_env.devices.ratings import DataCenterParams


class SiteSteps:
    """How sites with this clock law, highest draw and features step.

    Parameters
    ----------
    clock_law, boost_share
        Those of the sites.
    features
        Their features, from the chips towards the grid.
    parameters
        Their ratings.
    """

    def __init__(
        self, clock_law: Dvfs, boost_share: float, features: tuple[Any, ...], parameters: DataCenterParams
    ) -> None:
        self.clock_law, self.boost_share, self.features = clock_law, boost_share, features
        self.has_two_classes = work_classes_of(clock_law) == 2
        ends = np.cumsum([1, *(len(feature.channels(parameters)) for feature in features)]).tolist()
        self.channels_at = tuple(map(slice, ends[:-1], ends[1:]))
        """Positions of the set points of each feature, after that of the clock."""
        # What accounts for work served does so behind all that may put work back into the queue.
        self.order = sorted(range(len(features)), key=lambda i: getattr(features[i], "accounts_last", False))
        """The order in which features act on what was served."""
        drawing = tuple(i for i, feature in enumerate(features) if hasattr(feature, "with_supply"))
        self.drawing = {i: drawing for i, feature in enumerate(features) if drawing and hasattr(feature, "supplied")}
        """The features that draw power themselves, by the one that may leave them without."""
        self.admitting = tuple(i for i, feature in enumerate(features) if hasattr(feature, "admit"))
        """The features that act on work before it is served."""

    def without_features(
        self, params: DataCenterParams, state: DataCenterState, f_mhz: Array, work: Work, dt_s: float
    ) -> tuple[DataCenterState, Array]:
        """State and draw of sites whose work no feature has touched."""
        share = work.compute_share if self.has_two_classes else None
        boosts, queued = self.boost_share > 1.0, state.class_backlog_kws
        done = step(params, self.clock_law, queued, work.p_ref_kw, f_mhz, dt_s, share, boost=boosts)
        return _after(done, state, f_mhz)

    def with_features(
        self,
        params: DataCenterParams,
        state: SiteState,
        setpoints: tuple[Array, ...],
        inputs: FeatureInputs,
        dt_s: float,
    ) -> tuple[SiteState, Array]:
        """State and draw after all features have acted."""
        owns = list(state.features)
        if self.admitting:
            load = _load(params, inputs.work)
            for i in self.admitting:
                set_to = setpoints[self.channels_at[i]]
                owns[i], load = self.features[i].admit(params, state, owns[i], load, set_to, inputs.work, dt_s)
            inputs = inputs._replace(load=load)
            site, p_kw = self._admitted(params, state.site, setpoints[0], load, dt_s)
        else:
            site, p_kw = self.without_features(params, state.site, setpoints[0], inputs.work, dt_s)
        for i in self.order:
            set_to = setpoints[self.channels_at[i]]
            before_kw = p_kw
            owns[i], site, p_kw = self.features[i].step(params, owns[i], site, p_kw, set_to, inputs, dt_s)
            for j in self.drawing.get(i, ()):
                owns[j] = self.features[j].with_supply(owns[j], self.features[i].supplied(owns[i], before_kw))
        return SiteState._make((*site, tuple(owns))), p_kw

    def _admitted(
        self, params: DataCenterParams, state: DataCenterState, f_mhz: Array, load: Load, dt_s: float
    ) -> tuple[DataCenterState, Array]:
        share = load.compute_share if self.has_two_classes else None
        if self.boost_share > 1.0:  # no more than the boost, however much has come from elsewhere
            xp, most_kw = namespace(f_mhz), self.boost_share * params.p_rated_kw - params.p_idle_kw
            at_once = top_power(params.p_dynamic_kw, xp.minimum(load.arrived_kw, most_kw))
            params = params._replace(p_dynamic_kw=at_once)
        done = serve_arrived(
            params, self.clock_law, state.class_backlog_kws, load.base_kw, load.arrived_kw, f_mhz, dt_s, share,
            load.energy_share,
        )  # fmt: skip
        return _after(done, state, f_mhz)


def _load(params: DataCenterParams, work: Work) -> Load:
    """The work as it comes."""
    idle_kw, p_ref_kw = params.p_idle_kw, work.p_ref_kw
    return Load(idle_draw(idle_kw, p_ref_kw), arriving(idle_kw, p_ref_kw), work.compute_share)


def _after(done: DataCenterStep, state: DataCenterState, f_mhz: Array) -> tuple[DataCenterState, Array]:
    after = DataCenterState(
        done.backlog_kws, f_mhz, state.f_mhz, done.arrived_kw, done.served_kw, done.class_backlog_kws,
        done.class_arrived_kw, done.class_served_kw,
    )  # fmt: skip
    return after, done.p_kw
