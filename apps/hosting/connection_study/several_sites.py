"""Section on the sizes that the requested bus and further sites can have at once."""

from __future__ import annotations

from dcgrid_env.apps.hosting.capacity_output import together_table
from dcgrid_env.apps.hosting.connection_study.section import Section, sentences, under
from dcgrid_env.apps.hosting.connection_study.study_job import Job
from dcgrid_env.apps.hosting.load_hours import with_same_hours
from dcgrid_env.apps.hosting.sites_together import LimitsBroken, sites_together


def several_sites(job: Job) -> Section:
    """Find the sizes that all sites can have together under each controller."""
    request, others = job.request, job.request.several_sites
    assert others is not None
    study = with_same_hours(job.study, buses=(request.bus, *others.buses))
    rule = "equal shares as far as possible" if others.rule == "equal" else "the largest sum"
    text = f"Sites at buses {', '.join((request.bus, *others.buses))} connect at once; the rule is {rule}."
    name, title = "several-sites", "Several sites at once"
    try:
        results = [sites_together(study, law, controller, others.rule) for controller, law in job.controllers()]
    except LimitsBroken as error:
        return Section(name, title, f"No size fits: {error}.", (text,))
    said = []
    for one in results:
        mw = one.mw[one.buses.index(request.bus)]
        verdict = "fits" if request.mw <= mw + 1e-9 else "does not fit"
        said.append(
            f"{under(one.controller)}, bus {request.bus} has {mw:g} of {one.sum_mw:g} MW in total, and "
            f"{request.mw:g} MW {verdict}"
        )
    return Section(name, title, sentences(said), (text,), (together_table(results),))
