"""Where traces come from: records that a result can carry."""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from dcgrid_env.traces import (
    SERVICES,
    TRACE_SOURCES,
    PowerTrace,
    Provenance,
    Requests,
    Site,
    Tenant,
    generate_site,
    generate_training,
    replica,
    requests,
    serve,
)
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

    assert generated("x", 3, Params()).record() == {"name": "generator x", "seed": 3, "parameters": {"level": 0.5}}
    assert generated("x", NUMPY_THREE).record() == {"name": "generator x", "seed": 3}
    assert generated("x", 3, Params).record() == {"name": "generator x", "seed": 3}


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
        assert str(known) == f"{known.name}, seed 3"


def test_a_site_can_be_made_again_from_its_record():
    site = Site("H200", 32, (Tenant("code", "llama3-70b", 0.5, 0.1),), 0.25, daily_swing=0.1)
    first = generate_site(30.0, 51, site, correlation=0.5, group=9)
    record = json.loads(json.dumps(first.provenance.record()))
    known = record["parameters"]
    assert (known["day"], known["hour"]) == (2, 3)
    fields = {name: known[name] for name in ("gpu", "n_gpus", "training_share", "daily_swing")}
    again = Site(tenants=tuple(Tenant(**tenant) for tenant in known["tenants"]), **fields)
    second = generate_site(30.0, record["seed"], again, correlation=known["correlation"], group=known["group"])
    np.testing.assert_array_equal(first.power_kw, second.power_kw)


@pytest.mark.parametrize("name", SERVICES)
def test_requests_and_what_serves_them_say_where_they_are_from(name):
    made = requests(name, 0.1, NUMPY_THREE, rate_per_s=4.0)
    record = json.loads(json.dumps(made.provenance.record()))
    assert record["name"] == f"generator requests {name}"
    assert record["seed"] == 3
    assert record["parameters"]["hours"] == 0.1
    assert record["parameters"]["arrivals"]["rate_per_s"] == 4.0
    assert record["parameters"]["context"]["most"] == SERVICES[name].context.most
    assert serve(made, replica("H100", "llama3-8b")).trace.provenance is made.provenance


def test_other_traces_are_of_unknown_origin():
    assert str(PowerTrace([0, 1], [1, 1]).provenance) == "unknown origin"
    assert Requests(np.zeros(0), np.zeros(0, int), np.zeros(0, int), 1.0).provenance.record() == {}


def test_provenance_survives_scaling():
    trace = generate_training(30.0, 4)
    assert trace.scaled_to(280.0).provenance is trace.provenance
