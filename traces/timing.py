"""Time and memory to make a day of requests and of power: `python -m dcgrid_env.traces.timing`."""

import time
from collections.abc import Iterable

from dcgrid_env.traces.library import library
from dcgrid_env.traces.serving.services import requests
from dcgrid_env.traces.serving.site import Site, generate_site
from dcgrid_env.traces.sources import TRACE_SOURCES

MIB = 2.0**20


def peak_mib() -> float:
    """Largest resident memory of this process so far, MiB."""
    import resource  # does not exist on Windows

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def timed(call, *arguments):
    """What a call gives, and how long it takes, s."""
    begin = time.perf_counter()
    result = call(*arguments)
    return result, time.perf_counter() - begin


def main(hours: float = 24.0, sources: Iterable[str] = TRACE_SOURCES) -> None:
    """Print the figures for a day, or so many hours, and for sources of a scenario; compiling is not counted."""
    generate_site(1.0, 0)
    site = Site()
    for service in ("chat", "code"):
        drawn, took_s = timed(requests, service, hours, 0)
        print(f"requests({service!r}, hours={hours:g}): {len(drawn):,} requests, {took_s:.2f} s")
    before = peak_mib()
    trace, took_s = timed(generate_site, 3600.0 * hours, 0)
    assert trace.requests is not None
    assert trace.compute_kw is not None
    trace_mib = sum(array.nbytes for array in (trace.time_s, trace.power_kw, trace.compute_kw, *trace.requests)) / MIB
    rate = site.rate_per_s(site.tenants[0])
    print(
        f"{hours:g} h of a {site.rated_kw:.0f} kW site that answers {rate:.0f} chat requests a second: {took_s:.1f} s; "
        f"held {trace_mib:.0f} MiB at 0.1 s, {trace.resample(1.0).nbytes / MIB:.1f} MiB at 1 s; "
        f"peak memory {peak_mib():.0f} MiB, {before:.0f} of it before"
    )
    for source in sources:
        _, took_s = timed(library, source, "train", 1.0, 3600.0)
        print(f"library({source!r}), 24 rows of an hour, once a process: {took_s:.1f} s")


if __name__ == "__main__":
    main()
