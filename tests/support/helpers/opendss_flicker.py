"""Pst of a series of voltages as OpenDSS's own flicker monitor has it."""

from typing import Any

import numpy as np


def monitored_pst(v_pu: np.ndarray, dt_s: float, frequency_hz: float) -> float:
    """Pst of the first 600 s: a source follows the series as a load shape, and a monitor of mode 4 watches its line.

    The monitor's own base frequency, and nothing else, chooses between its filters for 120 and 230 V.
    """
    import opendssdirect

    dss: Any = opendssdirect.dss.NewContext()
    shape = " ".join(repr(float(v)) for v in v_pu)
    for command in (
        "clear",
        "new circuit.flicker phases=1 basekv=0.12 bus1=a.1 pu=1 r1=0 x1=1e-6 r0=0 x0=1e-6",
        f"new loadshape.voltage npts={len(v_pu)} sinterval={dt_s!r} mult=[{shape}]",
        "edit vsource.source duty=voltage",
        "new line.watched phases=1 bus1=a.1 bus2=b.1 r1=1e-6 x1=1e-6 r0=1e-6 x0=1e-6 c1=0 c0=0 length=1",
        "new load.small phases=1 bus1=b.1 kv=0.12 kw=1e-6 kvar=0 model=2 vminpu=0.1 vmaxpu=3",
        f"new monitor.flicker element=line.watched terminal=1 mode=4 basefreq={frequency_hz:g}",
        f"set voltagebases=[{0.12 * np.sqrt(3.0):.12g}]",
        "calcvoltagebases",
        f"set mode=duty stepsize={dt_s!r} number={len(v_pu)} controlmode=off",
        "solve",
    ):
        dss.Text.Command(command)
    dss.Monitors.First()
    dss.Monitors.Process()
    return float(dss.Monitors.AsMatrix()[-1, -1])
