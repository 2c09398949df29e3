"""What rules for large loads ask for, what a study of a distribution feeder says about it, and what it does not.

The rules are those of May 2026 as secondary sources report them. Each line must be checked against the final text.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dcgrid_env import RatingCoverage
from dcgrid_env.core.text_table import Table

_UNRATED = (
    "elements without a rating",
    "the feeder's files give none",
    "ratings from the owner, then this study again",
)
_OTHER_MEANS = (
    ("short-circuit currents", "no fault is simulated", "fault study with the sources and the site's contribution"),
    ("protection", "relays, fuses and reclosers are not modelled", "coordination study with the site's settings"),
    ("harmonics", "one frequency alone", "harmonic study with the spectrum of the converters"),
    ("frequency and transient stability", "steady state in each step, no machines", "study with dynamic models"),
    ("transmission grid", "the source has a fixed voltage", "study of the planner of the transmission grid"),
    ("changes within a step", "each step is an average", "measurement or a waveform study"),
)
"""What a connection needs that this report does not contain."""
_OF_SAGS = "load lost and voltages after recorded sags"
_HEADER = ("subject", "what sources state", "in this report", "to be checked")
_NERC = Table(
    "After NERC's Level 3 alert on computational loads (4 May 2026, responses due 3 August 2026)",
    _HEADER,
    (
        ("scope", "computational loads of 20 MW and more at 60 kV and above, with more than 1 MW of IT load",
         "rating and voltage of the connection", "whether the site is within the scope"),
        ("modelling data", "planners list data, settings and parameters and distribute them to owners",
         "rating, clock range, converter rating, ride-through curve, in the inputs", "the planner's list"),
        ("studies", "stability and protection studies, with the model PERC1 or an equivalent",
         "steady state and seconds on the feeder; neither stability nor protection", "both studies"),
        ("ride-through", "corrective actions against loss of load in normally cleared faults",
         _OF_SAGS, "protection settings, faults of the planner"),
        ("commissioning", "a process before energisation", "nothing", "the owner's process"),
        ("instrumentation", "dynamic fault recorders", "nothing", "recorder at the connection"),
        ("operations", "direct communication between operators and the load", "nothing", "agreement of operation"),
    ),
    ("Sources: epgsolutions.services (20 and 24 May 2026), morganlewis.com (May 2026).",),
)  # fmt: skip
_ERCOT = Table(
    "After ERCOT's NOGRR 282 and NPRR 1308 on large electronic loads",
    _HEADER,
    (
        ("scope", "sites of 75 MW and more with at least half of the demand from power electronics",
         "rating of the site", "whether the site is within the scope; exemptions to 14 November 2025"),
        ("voltage ride-through", "new section 2.14 of the Nodal Operating Guides",
         "the curve ercot-2026 can be chosen in ride_through.curve", "values of the final text"),
        ("frequency ride-through", "new section 2.6.4", "nothing: the model has no frequency", "settings of the UPS"),
    ),
    ("Source: epeconsulting.com, Preparing for NOGRR 282 (2026). It was a proposal then.",),
)  # fmt: skip


def other_means(coverage: RatingCoverage) -> Table:
    """Return what a connection needs that a report does not contain, from the known ratings of its feeder."""
    rows = (*_OTHER_MEANS, _UNRATED) if coverage.not_checked else _OTHER_MEANS
    return Table("To be checked by other means", ("subject", "why it is not in this report", "what to do"), rows)


def checklists(left_out: Sequence[str]) -> tuple[Table, ...]:
    """Return the checklists of a report without some sections."""
    if "ride-through" not in left_out:
        return _NERC, _ERCOT
    rows = (
        tuple("nothing: the section was left out" if cell == _OF_SAGS else cell for cell in row) for row in _NERC.rows
    )
    return replace(_NERC, rows=tuple(rows)), _ERCOT
