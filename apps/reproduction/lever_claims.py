"""Claims on what each lever does: inverters, bus 13, the control interval and the step of Fig. 3."""

from __future__ import annotations

import numpy as np

from dcgrid_env.apps.reproduction.bus13 import LARGEST_KW, OWN_KW
from dcgrid_env.apps.reproduction.paper import BAND_PU
from dcgrid_env.apps.reproduction.verdict import DOES_NOT, HOLDS, PARTLY, Records, Row, decide, row


def far(records: Records) -> Row:
    """Near and far inverters."""
    rows = records["inverters"]
    share = np.array([r["far_rise_pu_per_mvar"] / r["near_rise_pu_per_mvar"] for r in rows])
    near = np.mean([r["near_site_deviation_pu"] - r["none_site_deviation_pu"] for r in rows])
    far = np.mean([r["far_site_deviation_pu"] - r["none_site_deviation_pu"] for r in rows])
    weak, absorbs = (
        bool((share < 0.5).all()),
        "; a far inverter near the substation, where V > 1, even absorbs" * bool(far > 0.0),
    )
    strong = "under droop the far one brings no less than the near one" if weak else "for some sites it is over half"
    verdict = decide(weak and bool(near < far), bool((share < 1.0).any()))
    return row(
        "inverters far from a data centre are of limited help to it",
        "of limited help",
        f"1 Mvar at the farthest inverter moves a site by {100 * share.min():.0f} to {100 * share.max():.0f} % of what "
        f"it does at the nearest; 350 kvar under droop change its deviation by {far:+.4f} p.u. far, {near:+.4f} near",
        verdict,
        {
            HOLDS: f"an inverter moves the site only through the shared reactance (X_ij){absorbs}",
            PARTLY: f"an inverter moves the site only through the shared reactance (X_ij), but {strong}",
            DOES_NOT: "the far one shares as much reactance with every site as the near one",
        }[verdict],
    )


def bus_outside(records: Records) -> Row:
    """Whether bus 13 leaves the band."""
    b = records["bus_thirteen"]
    in_volts = max(b["five_outside_pct"], b["alone_outside_pct"]) > 0.0
    verdict = decide(in_volts, b["base_at_1pu_squared"] < 1.0 - BAND_PU)
    read = (
        "as the public code computes it (substation at 1.0 p.u., squared voltage, but without its tripled "
        "impedances), "
        f"{b['base_at_1pu']:.3f} p.u. without a data centre is {b['base_at_1pu_squared']:.3f}"
    )
    return row(
        "bus 13 leaves the band with inverters only",
        "outside the band",
        f"lowest V {b['five_min_pu']:.3f} p.u. with five sites, {b['alone_min_pu']:.3f} with one at bus 13 alone, "
        f"{b['five_at_1pu_min_pu']:.3f} with the substation at 1.0 p.u.; V² with that substation and no data "
        f"centre {b['base_at_1pu_squared']:.3f}",
        verdict,
        {
            HOLDS: "V leaves the band, with the substation at 1.044 p.u.",
            PARTLY: f"V stays inside, as bus 13 is near the substation; {read}, outside",
            DOES_NOT: f"bus 13 is near the substation; {read}, inside",
        }[verdict],
    )


def bus_why(records: Records) -> Row:
    """What brings bus 13 down."""
    b = records["bus_thirteen"]
    own_drop, others = b["drop_own_pu"], b["drop_neighbours_pu"]
    edge_kw = b["leaves_band_kw"]
    size = f"even {LARGEST_KW / 1000:g} MW there do not leave the band with them"
    if edge_kw is not None:
        size = f"leaving the band with them would take {edge_kw / 1000:.1f} MW there"
    small = "; size is not decisive" * (edge_kw is None or edge_kw > OWN_KW)
    verdict = decide(others > own_drop and b["five_outside_pct"] > 0.0, others > own_drop)
    return row(
        "bus 13 is explained by its neighbours and its size",
        "neighbours and size",
        f"its {OWN_KW:g} kW lower V by {own_drop:.4f} p.u., the four other sites by {others:.4f}; {size}",
        verdict,
        {
            HOLDS: "the neighbours matter more than the site itself, and with them it leaves the band",
            PARTLY: "the neighbours matter more than the site itself, through the shared path" + small,
            DOES_NOT: f"the neighbours matter no more than the site itself{small}",
        }[verdict],
    )


def interval(records: Records) -> Row:
    """Acting more often."""
    rows = {(r["k_p_mw_per_pu"], r["interval_s"]): r["late_deviation_pu"] for r in records["intervals"]}
    gains = sorted({k_p for k_p, _ in rows})
    said = [f"k_p = {k_p:g}: {', '.join(f'{rows[k_p, t]:.4f}' for t in (0.1, 1.0, 5.0))}" for k_p in gains]
    worse = [rows[k_p, 0.1] / rows[k_p, 1.0] - 1.0 for k_p in gains]
    no_worse = [change <= 0.01 for change in worse]
    verdict = decide(all(no_worse), any(no_worse))
    least = f"{100.0 * min(worse):+.1f}" if min(worse) < -0.01 else ""
    return row(
        "the law can be run at a faster interval than 1 s",
        "can be",
        f"second minute, every 0.1, 1, 5 s: {'; '.join(said)} p.u.",
        verdict,
        {
            HOLDS: f"at 0.1 s the deviation changes by up to {least} %: the law lags less behind the load"
            if least
            else "the gains are per second, so the loop is equally fast at any interval; a shorter one changes nothing",
            PARTLY: "at one of the two gains only",
            DOES_NOT: "acting more often makes it worse at both gains",
        }[verdict],
    )


def load_change(records: Records) -> Row:
    """The change of Fig. 3."""
    rows = {(r["change"], r["law"]): r for r in records["step"]["runs"]}
    drop, rise = rows["goes", "none"], rows["comes", "none"]
    head, injected = records["step"]["substation_pu"], records["step"]["site_pu"]
    rises = drop["after_pu"] > drop["before_pu"]
    verdict = decide(rises and drop["after_pu"] > head, rises)
    return row(
        "Fig. 3: without regulation the voltage can float high after a change in compute load",
        "can float high",
        f"load drops: {drop['before_pu']:.4f} to {drop['after_pu']:.4f} p.u.; load rises: "
        f"{rise['before_pu']:.4f} to {rise['after_pu']:.4f} p.u.; at the end with both axes "
        f"{rows['goes', 'both']['end_pu']:.4f} and {rows['comes', 'both']['end_pu']:.4f} p.u.",
        verdict,
        {
            HOLDS: f"after a drop of the load V is above the substation's {head:.3f} p.u.",
            PARTLY: f"the paper does not state whether load rises or drops; after a drop V rises, but not above the "
            f"substation's {head:.3f} p.u., as nothing injects power; as an injection the load would give "
            f"{injected:.4f} p.u.",
            DOES_NOT: "V does not rise, whether load rises or drops",
        }[verdict],
    )
