"""Where traces come from: records that a result can carry."""

import itertools
import json
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import pytest

from dcgrid_env.traces import (
    SERVICES,
    TRACE_SOURCES,
    InferenceParams,
    PowerSmoothing,
    PowerTrace,
    Provenance,
    Requests,
    Site,
    Tenant,
    TrainingParams,
    generate_inference,
    generate_site,
    generate_step,
    generate_training,
    library,
    replica,
    requests,
    row_seed,
    serve,
)
from dcgrid_env.traces.boost import boosted_trace
from dcgrid_env.traces.provenance import generated

# A seed out of an array.
NUMPY_THREE: Any = np.int64(3)


def test_a_record_leaves_out_what_does_not_apply():
    assert Provenance().record() == {}
    assert Provenance("file.csv", sha256="ab" * 32).record() == {"name": "file.csv", "sha256": "ab" * 32}
    assert Provenance("generator x", seed=0).record() == {"name": "generator x", "seed": 0}


def test_text():
    assert str(Provenance()) == "unknown origin"
    assert str(Provenance("generator x", seed=0)) == "generator x, seed 0"
    assert str(Provenance("a.csv", sha256="0123456789abcdef", licence="MIT")) == "a.csv, sha256 0123456789ab, MIT"


def test_parameters_of_a_generator():
    @dataclass
    class Params:
        level: float = 0.5

    known = {"name": "generator x", "seed": 3, "parameters": {"duration_s": 60.0}}
    assert generated("x", 3, 60).record() == known
    assert generated("x", NUMPY_THREE, 60.0).record() == known
    known["parameters"] = {"duration_s": 60.0, "params": {"level": 0.5}, "step_s": 2.0, "group": None}
    assert generated("x", 3, 60.0, params=Params(), step_s=2.0, group=None).record() == known


@pytest.mark.parametrize("shifted", [False, True])
@pytest.mark.parametrize("source", TRACE_SOURCES)
def test_every_source_says_what_it_is(source, shifted):
    generate = (shifted and TRACE_SOURCES[source].shifted) or TRACE_SOURCES[source].generate
    for seed in (3, NUMPY_THREE):
        known = generate(30.0, seed).provenance
        record = json.loads(json.dumps(known.record()))
        assert record["name"] == known.name
        assert record["name"].startswith("generator ")
        assert record["seed"] == 3
        assert record["parameters"]["duration_s"] == 30.0
        assert str(known) == f"{known.name}, seed 3"


@pytest.mark.parametrize(
    ("source", "names"),
    [
        ("inference", {"params"}),
        ("training", {"params"}),
        ("mixed", {"inference", "training"}),
        ("step", {"step_s"}),
        *((source, {"site", "hour", "correlation", "group"}) for source in ("chat", "code", "site", "deepseek-v3")),
    ],
)
def test_parameters_stand_under_the_names_of_their_arguments(source, names):
    known = TRACE_SOURCES[source].generate(30.0, 3).provenance
    assert set(known.parameters) == {"duration_s", *names}


def test_traces_can_be_made_again_from_their_records():
    params = InferenceParams(n_servers=2, gap_mean_s=20.0)
    first = generate_inference(60.0, 3, params)
    known = json.loads(json.dumps(first.provenance.record()))["parameters"]
    again = generate_inference(known["duration_s"], 3, InferenceParams(**known["params"]))
    np.testing.assert_array_equal(first.power_kw, again.power_kw)
    first = generate_training(60.0, 3, TrainingParams(n_slots=(2, 2), smoothing=PowerSmoothing(0.5)))
    known = json.loads(json.dumps(first.provenance.record()))["parameters"]
    smoothing = PowerSmoothing(**known["params"].pop("smoothing"))
    fields: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in known["params"].items()
    }
    again = generate_training(known["duration_s"], 3, TrainingParams(**fields, smoothing=smoothing))
    np.testing.assert_array_equal(first.power_kw, again.power_kw)


def test_a_site_can_be_made_again_from_its_record():
    site = Site("H200", 32, (Tenant("code", "llama3-70b", 0.5, 0.1),), 0.25, daily_swing=0.1)
    first = generate_site(30.0, 51, site, correlation=0.5, group=9)
    record = json.loads(json.dumps(first.provenance.record()))
    known = record["parameters"]
    assert known["hour"] == 3
    assert "day" not in known
    fields = {name: known["site"][name] for name in ("gpu", "n_gpus", "training_share", "daily_swing")}
    again = Site(tenants=tuple(Tenant(**tenant) for tenant in known["site"]["tenants"]), **fields)
    second = generate_site(
        known["duration_s"], record["seed"], again, correlation=known["correlation"], group=known["group"]
    )
    np.testing.assert_array_equal(first.power_kw, second.power_kw)


def different_traces():
    """Traces of one seed whose power differs, each with what it is."""
    for source, known in TRACE_SOURCES.items():
        for kind, generate in (("plain", known.generate), ("shifted", known.shifted)):
            if generate is not None:
                for duration_s in (60.0, 60.1):
                    trace = generate(duration_s, 5)
                    yield f"{source} {kind} {duration_s}", trace
                    yield f"{source} {kind} {duration_s} boosted", boosted_trace(trace, 1.3)
                yield f"{source} {kind} boosted more", boosted_trace(generate(60.0, 5), 1.4)
    yield "a later step", generate_step(60.0, 5, step_s=30.0)
    unit = Site("H100", 16, (Tenant("chat", "llama3-70b", 1.0, 0.2),))
    yield "a site", generate_site(60.0, 5, unit)
    yield "a site alike", generate_site(60.0, 5, replace(unit, daily_swing=0.1))
    for group in (1, 2):
        yield f"a site of group {group}", generate_site(60.0, 5, unit, correlation=1.0, group=group)
    for rate_per_s in (3.0, 4.0):
        made = requests("chat", 1 / 60, 5, rate_per_s=rate_per_s)
        for gpu, model, n_replicas in itertools.product(("H100", "H200"), ("llama3-8b", "llama3-70b"), (1, 2)):
            name = f"{rate_per_s} on {n_replicas} {gpu} {model}"
            yield name, serve(made, replica(gpu, model), n_replicas).trace


@pytest.mark.slow
def test_traces_that_differ_say_so():
    traces = dict(different_traces())
    said = {}
    for name, trace in traces.items():
        record = json.dumps(trace.provenance.record(), sort_keys=True)
        assert record not in said, f"{name} says it is {said.get(record)}"
        said[record] = name
    assert len(said) > 90


@pytest.mark.parametrize("source", ["mixed", "step", "chat"])
def test_rows_say_what_they_are(source):
    for boost_share in (1.0, 1.3):
        rows = library(source, "validation", 1.0, 60.0, 3, boost_share)
        assert len(rows.provenance) == 3
        for row, known in enumerate(rows.provenance):
            seed = row_seed("validation", row)
            made = TRACE_SOURCES[source].generate(60.0, seed)
            parameters = {**made.provenance.parameters, **({"boost_share": 1.3} if boost_share > 1.0 else {})}
            assert known == replace(made.provenance, parameters=parameters)
            assert known.seed == seed


@pytest.mark.parametrize("name", SERVICES)
def test_requests_and_what_serves_them_say_where_they_are_from(name):
    made = requests(name, 0.1, NUMPY_THREE, rate_per_s=4.0)
    record = json.loads(json.dumps(made.provenance.record()))
    assert record["name"] == f"generator requests {name}"
    assert record["seed"] == 3
    assert record["parameters"]["hours"] == 0.1
    assert record["parameters"]["arrivals"]["rate_per_s"] == 4.0
    assert record["parameters"]["context"]["most"] == SERVICES[name].context.most
    known = serve(made, replica("H100", "llama3-8b")).trace.provenance
    served_by = {"replica": asdict(replica("H100", "llama3-8b")), "replicas": 1}
    assert known.parameters == {**made.provenance.parameters, "served_by": served_by}
    assert str(known) == str(made.provenance)
    json.dumps(known.record())


def test_other_traces_are_of_unknown_origin():
    assert str(PowerTrace([0, 1], [1, 1]).provenance) == "unknown origin"
    assert Requests(np.zeros(0), np.zeros(0, int), np.zeros(0, int), 1.0).provenance.record() == {}


def test_provenance_survives_scaling():
    trace = generate_training(30.0, 4)
    assert trace.scaled_to(280.0).provenance is trace.provenance
