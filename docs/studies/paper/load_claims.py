"""Claims on the load: its ramps, the size of models, and what is too fast for tap changers."""

from __future__ import annotations

from dcgrid_env.apps.reproduction.verdict import DOES_NOT, HOLDS, PARTLY, Records, Row, decide, row
from docs.studies.paper.load_swings import DIP_FEEDER

_MIDDLE = ("mixtral-8x22b", "deepseek-v3")


def taps(records: Records) -> Row:
    """Tap changers against dips of different lengths."""
    dips = sorted((r for r in records["dips"] if r["dip_s"]), key=lambda r: r["dip_s"])
    still = [r["dip_s"] for r in dips if not r["taps"]]
    moved = [r for r in dips if r["taps"]]
    short = [r for r in dips if r["dip_s"] <= 1.0]
    verdict = decide(not any(r["taps"] for r in short), bool(still))
    said = f"five sites idle at once: no tap in dips of {min(still):g} to {max(still):g} s" if still else "taps move"
    if moved:
        said += f", {moved[0]['taps']:.0f} taps in one of {moved[0]['dip_s']:g} s"
    return row(
        "tap changers are too slow for dips of a second or less",
        "cannot act on (sub)second transients",
        f"{said} ({DIP_FEEDER}); a site's voltage moves by up to {max(r['largest_change_pu'] for r in dips):.4f} p.u.",
        verdict,
        {
            HOLDS: "a regulator waits 15 or 30 s before its first tap, and its timer resets when the voltage recovers",
            PARTLY: "a regulator may tap within a second, but not in the shortest dip",
            DOES_NOT: "a regulator taps even in the shortest dip",
        }[verdict],
    )


def larger_models(records: Records) -> Row:
    """The largest model against those of middle size."""
    rows = {r["model"]: r for r in records["models"]}
    large, middle = rows["llama3-405b"], [rows[name] for name in _MIDDLE]
    less = [large["std_pct"] < r["std_pct"] and large["ramp_pct"] < r["ramp_pct"] for r in middle]
    verdict = decide(all(less), any(less))
    listed = ", ".join(f"{name} {r['std_pct']:.0f} and {r['ramp_pct']:.0f}" for name, r in rows.items())
    return row(
        "Llama 3 405B is not more dynamic than models of middle size",
        "Mixtral-8x22B and DeepSeek-V3 fluctuate more",
        f"standard deviation and 99 % of the 1 s ramps, % of the rating: {listed}",
        verdict,
        {
            HOLDS: "on this project's generators; the four recordings behind Fig. 2 are not published",
            PARTLY: "for one of the two only, on this project's generators; the recordings are not published",
            DOES_NOT: "on this project's generators; the recordings are not published",
        }[verdict],
    )


def ramps(records: Records) -> Row:
    """Which ramps dominate."""
    said, first = [], []
    for r in records["ramps"]:
        shares = r["shares_pct"]
        first.append(max(shares, key=shares.__getitem__) == "10 to 20 %")
        said.append(f"every {r['interval_s']:.2g} s {shares['10 to 20 %']:.0f} % of {r['large']}")
    verdict = decide(all(first), any(first))
    small = 100.0 * (1.0 - records["ramps"][0]["large"] / records["ramps"][0]["ramps"])
    return row(
        "ramps of 10 to 20 % dominate",
        "the 10-20 % range dominates",
        f"of the ramps beyond 5 % of the peak: {'; '.join(said)}",
        verdict,
        f"{small:.0f} % of all changes from sample to sample are below 5 %; "
        + {
            HOLDS: "most of the larger ones are 10 to 20 %",
            PARTLY: "which larger ones dominate depends on the interval, which the paper does not state",
            DOES_NOT: "other larger ones are more frequent",
        }[verdict],
    )
