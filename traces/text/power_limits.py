"""The highest power that is believed of a meter, in all files."""

import math
import re

import numpy as np

from dcgrid_env.traces.checks import FloatArray

DEVICE_KW = 2.0
"""Highest accepted reading of one GPU, processor or other device, kW; the largest of 2026 are rated at 1.4 kW."""
SITE_KW = 1e6
"""Highest accepted reading of another meter, such as that of a node, a rack or a site, kW."""
SPIKE_TIMES = 20.0
SPIKE_SHARE = 0.01
SPIKE_READINGS = 10
"""A reading above DEVICE_KW is an outlier if it is SPIKE_TIMES as high as all but a share of SPIKE_SHARE of the meter's
readings, of which there are at least SPIKE_READINGS."""

_DEVICE = re.compile(
    r"(?<![a-z])(?:(?:gpu|gcd|xpu|npu|tpu|cpu|socket|card)[ _.:=#\[(-]*\d+(?!\d*\s*(?:-|to|\.\.)\s*\d)|gpu-[0-9a-f]{8}-"
    r"|uuid=)|dcgm_fi_dev",
    re.IGNORECASE,
)
"""Names of one device: `GPU 3`, `cpu0`, `GPU-09cb2925-...`; `gpus`, `gpu total` and `gpu0-7` are several."""
_SEVERAL = re.compile(r"(?<![a-z])(?:sum|all)(?![a-z])", re.IGNORECASE)


def limit_of(meter: str, limit_kw: float | None) -> float:
    """Return the highest accepted reading of a meter or column by its name, kW; `limit_kw` if the caller gave one."""
    if limit_kw is not None:
        return limit_kw
    return DEVICE_KW if _DEVICE.search(meter) and not _SEVERAL.search(meter) else SITE_KW


def above_limit(limit_kw: float) -> str:
    """Return what a message says of a reading above the limit."""
    return (
        f"above {limit_kw:g} kW, the highest that is believed of this meter; repair or remove the reading, correct the "
        "unit, or raise limit_kw if it is right"
    )


def outlier(power_kw: FloatArray) -> int | None:
    """Return the index of the highest reading if it is an outlier; None if it is not."""
    n = len(power_kw)
    if n < SPIKE_READINGS:
        return None
    rest = n - 1 - max(1, int(SPIKE_SHARE * n))
    highest = int(np.argmax(power_kw))
    usual_kw = float(np.partition(power_kw, rest)[rest])
    return highest if power_kw[highest] > max(DEVICE_KW, SPIKE_TIMES * usual_kw) else None


def outlier_text(power_kw: float, usual_kw: float) -> str:
    """Return what a message says of an outlier; `usual_kw` is the median of the meter."""
    return (
        f"an outlier: {power_kw:g} kW, and the median of all readings is {usual_kw:.4g} kW; repair or remove the "
        f"reading, or pass limit_kw={math.ceil(power_kw)} or more if it is right"
    )
