"""Statements by which published distribution cases convert their tables to MATPOWER's units, recognised by their text.

A case file is never executed. MATPOWER's distribution cases store ohms and kW and end with the statements below, most
of them word for word; every other statement is refused (docs/decisions/0034-own-code-or-library.md).
"""

from __future__ import annotations

import math
import re

import numpy as np

from dcgrid_env.grid.topology import FeederError

_NUMBER = re.compile(r"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?|[iI]nf|NaN|nan)", re.ASCII)
_QUOTIENT = re.compile(r"(?P<top>[^/]+)/(?:sqrt\((?P<root>[^()]+)\)|(?P<bottom>[^/]+))")
_POWER_FACTOR = re.compile(r"pf\s*=\s*(0?\.\d+)")


def number(text: str) -> float:
    """Value of a number as MATLAB writes it, or of ``a/b`` or ``a/sqrt(b)``; ValueError for other text."""
    if _NUMBER.fullmatch(text):
        return float(text.replace("d", "e").replace("D", "e"))
    if quotient := _QUOTIENT.fullmatch(text):
        top, root, bottom = quotient.group("top", "root", "bottom")
        divisor = math.sqrt(number(root)) if root else number(bottom)
        if divisor != 0:
            return number(top) / divisor
    raise ValueError(f"{text!r} is not a number")


def _words(text: str) -> str:
    """The text with one space between words and signs, and without commas, which separate as spaces do."""
    return " ".join(re.findall(r"\w+|[^\s\w,]", text))


_WITHOUT_EFFECT = {
    _words(text)
    for text in (
        "define_constants",
        "[PQ, PV, REF, NONE, BUS_I, BUS_TYPE, PD, QD, GS, BS, BUS_AREA, VM, VA, BASE_KV, ZONE, VMAX, VMIN,"
        " LAM_P, LAM_Q, MU_VMAX, MU_VMIN] = idx_bus",
        "[F_BUS, T_BUS, BR_R, BR_X, BR_B, RATE_A, RATE_B, RATE_C, TAP, SHIFT, BR_STATUS, PF, QF, PT, QT, MU_SF, MU_ST,"
        " ANGMIN, ANGMAX, MU_ANGMIN, MU_ANGMAX] = idx_brch",
        "Vbase = mpc.bus(1, BASE_KV) * 1e3",
        "Sbase = mpc.baseMVA * 1e6",
    )
}
_OHM = _words("mpc.branch(:, [BR_R BR_X]) = mpc.branch(:, [BR_R BR_X]) / (Vbase^2 / Sbase)")
_KW = _words("mpc.bus(:, [PD, QD]) = mpc.bus(:, [PD, QD]) / 1e3")
_KVA_TO_Q = _words("mpc.bus(:, QD) = mpc.bus(:, PD) * sin(acos(pf))")
_KVA_TO_P = _words("mpc.bus(:, PD) = mpc.bus(:, PD) * pf")


class Conversions:
    """Applies the statements of one file to its tables; ``pf`` is the power factor that the file sets."""

    def __init__(self, file: str, tables: dict[str, np.ndarray]) -> None:
        self.file, self.tables, self.pf = file, tables, math.nan

    def apply(self, line: int, text: str, base_mva: float) -> str:
        """Convert a table as a statement says and return what was done, "" for a statement without effect.

        Raises
        ------
        FeederError
            For any other statement, and for one that comes before the table that it converts.
        """
        words, bus, branch = _words(text), self.tables.get("bus"), self.tables.get("branch")
        factor = _POWER_FACTOR.fullmatch(text)
        if factor:
            self.pf = float(factor[1])
        elif words == _OHM and bus is not None and len(bus) and branch is not None and base_mva > 0:
            with np.errstate(all="ignore"):  # figures are checked when all statements are read
                branch[:, 2:4] = branch[:, 2:4] / ((bus[0, 9] * 1e3) ** 2 / (base_mva * 1e6))
            return "r and x are converted from ohms to p.u."
        elif words == _KW and bus is not None:
            bus[:, 2:4] = bus[:, 2:4] / 1e3
            return "loads are converted from kW to MW"
        elif words == _KVA_TO_Q and bus is not None and self.pf > 0:
            bus[:, 3] = bus[:, 2] * math.sin(math.acos(self.pf))
            return "reactive loads are computed from the power factor"
        elif words == _KVA_TO_P and bus is not None and self.pf > 0:
            bus[:, 2] = bus[:, 2] * self.pf
            return "loads are multiplied by the power factor"
        elif words not in _WITHOUT_EFFECT:
            raise self.refused(line, text)
        return ""

    def refused(self, line: int, text: str, why: str = "") -> FeederError:
        """Return the error for a statement that is not read."""
        shown = " ".join(text.split())
        shown = shown if len(shown) <= 80 else shown[:77] + "..."
        return FeederError(
            f"{self.file}, line {line}: the MATLAB code {shown!r} is not read{f' ({why})' if why else ''}; case files "
            "are not executed: run it in MATPOWER or Octave and save the case by savecase"
        )
