"""Power readings in JSON: exports of Prometheus, reports and polls of Redfish, and runs of the ML.ENERGY benchmark."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any, NamedTuple

from dcgrid_env.core.user_files import MOST_MIB, parse_json
from dcgrid_env.traces.checks import TraceError
from dcgrid_env.traces.logs.meters import Meters, one_of
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.recording_clock import BEGAN, UTC_OFFSET
from dcgrid_env.traces.text.cells import reading
from dcgrid_env.traces.text.dates import seconds
from dcgrid_env.traces.text.power_unit import column_unit, require_power
from dcgrid_env.traces.text.text_file import TextFile, open_text, stem
from dcgrid_env.traces.text.times import clock_text
from dcgrid_env.traces.trace import PowerTrace

FORMS = (
    "a range query of Prometheus, metric reports or polled Power resources of Redfish, or results.json of the "
    "ML.ENERGY benchmark"
)
_IN_WATTS = ("DCGM_FI_DEV_POWER_USAGE", "DCGM_FI_DEV_POWER_USAGE_INSTANT")
"""Metrics of the DCGM exporter whose names do not contain their unit, W."""
_IDENTITY = (("UUID",), ("uuid",), ("Hostname", "gpu"))
"""Labels that identify a GPU, the first that a series has; the others change when a pod or exporter restarts."""
_TIMES = ("Timestamp", "timestamp", "time", "Time", "DateTime")
_REDFISH = "PowerConsumedWatts"
_REPORTED = (_REDFISH, "PowerWatts", "PowerWatts/Reading", "SystemPowerConsumption", "SystemInputPower")
"""Ends of the properties and names of metrics of Redfish that are power in W."""


class _Reading(NamedTuple):
    """A reading and its place in the file."""

    meter: str
    time_s: float
    value: float
    place: int


def read_power_json(
    path: str | os.PathLike[str],
    *,
    metric: str | None = None,
    unit: str | None = None,
    max_gap_s: float | None = None,
    gaps: str = "error",
    limit_kw: float | None = None,
    name: str | None = None,
) -> PowerTrace:
    """Read the power of all meters of a JSON file, summed.

    A reading applies until the next one of its meter. The forms are:

    - Prometheus: the answer to `/api/v1/query_range`. Series of one GPU, which labels of pods may split, are joined by
      the label `UUID`, or by `Hostname` and `gpu`. Values that are not a number are missing.
    - Redfish: one or more objects, in a list or one a line. Each is a MetricReport, or a Power or EnvironmentMetrics
      resource with a field `Timestamp`, `timestamp`, `time` or `DateTime` that the poll added.
    - ML.ENERGY benchmark v3: `results.json` of a run, with the power of each GPU (`timeline.power.device_instant`).

    Parameters
    ----------
    path : text file, UTF-8, plain or gzip.
    metric : name of the metric, if the file has several of power.
    unit : unit of the readings, if their name does not contain it: "W", "kW", "MW" or "mW".
    max_gap_s, gaps : rule for readings of a meter that are far apart, see `dcgrid_env.traces.logs.meters.Meters`.
    limit_kw : highest accepted reading, kW; by default 2 kW for a GPU, and 1 GW for others, whose outliers are refused
        too.
    name : name of the trace; by default the file's name without suffix.

    Raises
    ------
    TraceError
        If the file is not JSON of these forms, has several metrics, lacks a unit, times of a meter repeat or go back,
        or there is a gap. The message contains the file and the meter.

    References
    ----------
    Prometheus documentation, "HTTP API"; DMTF DSP0268, "Redfish Data Model Specification"; mlenergy-data 0.3.2.
    """
    with open_text(path, MOST_MIB) as file:
        objects = _objects(file)
        sha256 = file.sha256()
    metric_name, stated, readings = _readings(file.name, objects, metric)
    require_power(
        f"{file.name}: metric",
        metric_name,
        f"export a metric of power, or the rate of the counter, rate({metric_name}[1m]), in W",
    )
    known = stated or column_unit(f"{file.name}: {metric_name}", metric_name, unit)
    if known is None:
        raise TraceError(f"{file.name}: {metric_name or 'an expression'} names no unit; pass unit= (W, kW, MW or mW)")
    meters = Meters(
        file.name, metric_name or "the expression", known, max_gap_s=max_gap_s, gaps=gaps, limit_kw=limit_kw,
        placed=lambda meter, place: f"{file.name}: {meter}, value {place}",
    )  # fmt: skip
    for meter, time_s, value, place in readings:
        meters.add(meter, time_s, value, place)
    total = meters.total()
    parameters = {BEGAN: clock_text(total.begin_s), UTC_OFFSET: 0.0}
    parameters |= {"meters": len(meters.meters), "metric": metric_name or "an expression"}
    return total.trace(name or stem(path), Provenance(file.name, None, parameters | total.notes, sha256))


def _objects(file: TextFile) -> list[Any]:
    """Return the JSON objects of a file: the only one, those of a list, or one a line."""
    text, remedy = "".join(block.text for block in file.blocks()), f"export {FORMS}"
    try:
        content = parse_json(text, file.name, TraceError, remedy)
        return content if isinstance(content, list) else [content]
    except TraceError as error:
        whole = error
    objects: list[Any] = []
    for number, line in enumerate(text.split("\n"), 1):
        if line.strip():
            try:
                objects.append(parse_json(line, f"{file.name}, line {number}", TraceError, remedy))
            except TraceError as error:
                raise (error if objects else whole) from None
    return objects


def _readings(name: str, objects: list[Any], metric: str | None) -> tuple[str, str | None, list[_Reading]]:
    """Return the metric, its unit if its form defines it, and the readings, sorted by time for each meter."""
    if not objects or not all(isinstance(item, dict) for item in objects):
        raise TraceError(f"{name}: is not a JSON object, or a list of them; export {FORMS}")
    first = objects[0]
    try:
        if isinstance(first.get("data"), dict) and "resultType" in first["data"]:
            metric_name, readings = _prometheus(name, first["data"], metric)
            return metric_name, "W" if metric_name in _IN_WATTS else None, readings
        if isinstance(first.get("timeline"), dict):
            return _ml_energy(name, first["timeline"], metric)
        if "MetricValues" in first:
            metric_name, readings = _metric_reports(name, objects, metric)
            return metric_name, "W", readings
        if any(key in first for key in ("PowerControl", "PowerWatts", _REDFISH)):
            return _REDFISH, "W", sorted(_polled(name, objects), key=_time_s)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, TraceError):
            raise
        raise TraceError(f"{name}: a field has another form than expected ({error!r}); export {FORMS}") from error
    raise TraceError(f"{name}: has the fields {', '.join(list(first)[:8])}; export {FORMS}")


def _prometheus(name: str, data: dict[str, Any], metric: str | None) -> tuple[str, list[_Reading]]:
    if data["resultType"] != "matrix":
        raise TraceError(
            f"{name}: is a query of type {data['resultType']!r}; export a range query (/api/v1/query_range)"
        )
    series = data["result"]
    if not series:
        raise TraceError(f"{name}: the query has no series; correct its metric and its range of time")
    metric_name = one_of((item["metric"].get("__name__", "") for item in series), metric, name, "metric=")
    readings: list[_Reading] = []
    for item in series:
        labels = item["metric"]
        if labels.get("__name__", "") == metric_name:
            keys = next((keys for keys in _IDENTITY if all(key in labels for key in keys)), sorted(labels))
            meter = ", ".join(f"{key}={labels[key]}" for key in keys if key != "__name__") or "the series"
            readings += (
                _Reading(meter, seconds(time, name), reading(value), n)
                for n, (time, value) in enumerate(item["values"], 1)
            )
    return metric_name, sorted(readings, key=_time_s)


def _ml_energy(name: str, timeline: dict[str, Any], metric: str | None) -> tuple[str, str, list[_Reading]]:
    kinds = timeline["power"]
    metric_name = one_of(kinds, metric or ("device_instant" if "device_instant" in kinds else None), name, "metric=")
    return metric_name, "W", [
        _Reading(f"GPU {gpu}", seconds(time, name), reading(watt), n)
        for gpu, values in kinds[metric_name].items()
        for n, (time, watt) in enumerate(values, 1)
    ]  # fmt: skip


def _metric_reports(name: str, objects: list[dict[str, Any]], metric: str | None) -> tuple[str, list[_Reading]]:
    values = [
        (n, value, str(value.get("MetricProperty") or value.get("MetricId") or ""))
        for n, value in enumerate((value for report in objects for value in report["MetricValues"]), 1)
    ]
    named = [(n, value, prop, value.get("MetricId") or prop.rpartition("/")[2]) for n, value, prop in values]
    if metric is None:
        power = [entry for entry in named if entry[2].endswith(_REPORTED) or entry[3].endswith(_REPORTED)]
    else:
        power = [entry for entry in named if entry[3] == metric]
    metric_name = one_of({entry[3] for entry in power}, None, f"{name}: power in MetricValues", "metric=")
    readings = [
        _Reading(
            prop or metric_name,
            seconds(value["Timestamp"], f"{name}: {metric_name}, value {n}"),
            reading(value["MetricValue"]),
            n,
        )
        for n, value, prop, _ in power
    ]
    # Reports overlap: a value that several of them contain is one reading.
    once = {(one.meter, one.time_s, one.value): one for one in readings}
    return metric_name, sorted(once.values(), key=_time_s)


def _polled(name: str, objects: list[dict[str, Any]]) -> Iterator[_Reading]:
    """Yield the readings of polled Power or EnvironmentMetrics resources."""
    for n, item in enumerate(objects, 1):
        time = next((item[key] for key in _TIMES if key in item), None)
        if time is None:
            raise TraceError(
                f"{name}: object {n} has no time; add a field Timestamp when the resource is polled, as Redfish's own "
                "has none"
            )
        time_s, source = seconds(time, f"{name}: object {n}"), str(item.get("@odata.id") or item.get("host") or "Power")
        for control in item.get("PowerControl", ()):
            meter = f"{source} {control.get('MemberId', control.get('Name', ''))}".strip()
            yield _Reading(meter, time_s, reading(control[_REDFISH]), n)
        if "PowerWatts" in item:
            watt = item["PowerWatts"]
            yield _Reading(source, time_s, reading(watt["Reading"] if isinstance(watt, dict) else watt), n)
        elif _REDFISH in item:
            yield _Reading(source, time_s, reading(item[_REDFISH]), n)


def _time_s(one: _Reading) -> float:
    return one.time_s
