"""Describe what cannot be reproduced and how the authors' public code differs from the paper."""

from __future__ import annotations

from dcgrid_env.apps.reproduction.markdown_tables import table, wrapped

REPOSITORY = "github.com/chennnnnyize/voltage-regulation-with-data-centers"
COMMIT = "c9e3c78"
"""The version that was read."""
MISSING = (
    (
        "Table I to the digit",
        "the paper does not give the substation voltage, the equivalent feeder, the inverters' buses and ratings, the "
        "reactive limits, k_q, alpha, the unit of k_p, the noise, the placements or the seeds",
    ),
    ("whether Table I contains V or V²", "the text states the voltage magnitude; the public code computes V²"),
    (
        "Figs. 1 and 2",
        "one recording of inference is published; those of the training and of the four models are not",
    ),
    ("Fig. 3", "the text does not state which load changes, or in which direction"),
    ("Figs. 6 and 7", "the episode, the other data centres and their loads are not given"),
    (
        "the results from the authors' code",
        "two of its input files are missing, and it has no backlog and no delay",
    ),
)
"""What cannot be reproduced, and why."""
DIFFERENCES = (
    (
        "input",
        "-",
        "reads `Generator_Data.csv` and a module `util`, which are not in the repository, and `Bus_Data.csv`, which is "
        "named `Bus_data.csv` there",
    ),
    (
        "power flow",
        "nonlinear DistFlow",
        "branch flows without losses; the quadratic for the voltage has the opposite sign in its loss term, so the "
        "loss raises the voltage",
    ),
    ("voltage", "magnitude", "V², set to 1 at the substation, used as the magnitude in the law and in the plots"),
    ("impedances", "IEEE 123-bus", "three times those of the file"),
    ("capacitors, regulators", "not mentioned", "listed, not used"),
    (
        "data centres",
        "1 to 5, at random",
        "8, at the indices 13, 24, .., which are the buses 14, 25, .., as bus 1 has index 0",
    ),
    ("control of data centres", "at the data centres", "at the indices 0 to 7, none of which has a data centre"),
    (
        "inverters",
        "buses not given",
        "the list of buses is converted to indices twice, which gives 0, 9, 38, 52, 85, 90 and 101; index 85 also has "
        "a data centre, whose load the law overwrites",
    ),
    (
        "inverters only",
        "a separate case",
        "the inverters respond to the voltage under both controls, so it is not a run without data-centre control",
    ),
    (
        "law",
        "(5) to (7), k_p = 1, 10, 20",
        "gains of 4 for P and 2 for Q; inverters regulate P too; no limits, no backlog, no delay",
    ),
    ("noise of the other loads", "Gaussian", "one draw for each bus, constant over the run"),
)
"""What the public code does differently from the paper: topic, paper, code."""


def render_limits() -> str:
    """Render the section on results that cannot be reproduced."""
    read = (
        f"The paper refers to [{REPOSITORY}](https://{REPOSITORY}). The table lists differences between its study of "
        f"the 123-bus feeder and the paper, as of commit `{COMMIT}`. The code was read, not run. This project uses its "
        "recording and its lists of data-centre and inverter buses, read as bus numbers."
    )
    others = (
        "`toy_droop_6bus_timevarying.py` is the six-bus example. Its load enters as a negative injection, so without "
        "control the voltage falls when the load rises. `socp_123bus.py` is an optimisation that the paper does not "
        "report. None of the three scripts computes the deviations or the delays of Table I."
    )
    return f"""## Results that cannot be reproduced

{table(("result", "reason"), MISSING)}

### The authors' public code

{wrapped(read)}

{table(("topic", "in the paper", "in `droop_123bus_DC.py`"), DIFFERENCES)}

{wrapped(others)}"""
