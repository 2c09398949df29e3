"""A claim's row: what the paper says, what comes out here, the verdict and one line why."""

from __future__ import annotations

from typing import Any

Records = dict[str, Any]
Row = dict[str, str]
VERDICTS = HOLDS, PARTLY, DOES_NOT = ("holds", "partly", "does not")


def row(claim: str, paper: str, ours: str, verdict: str, reason: str) -> Row:
    """A row of the table of claims."""
    return {"claim": claim, "paper": paper, "ours": ours, "verdict": verdict, "reason": reason}


def decide(whole: bool, part: bool) -> str:
    """The verdict on a claim that holds as a whole, or in part."""
    return HOLDS if whole else PARTLY if part else DOES_NOT
