"""Every number on the command line has a limit, which is checked before anything is computed."""

import dataclasses
import typing
from typing import Any

import pytest

from dcgrid_command.command_table import COMMANDS
from dcgrid_command.group import Entry
from dcgrid_env.agents.train_command import ALGORITHMS
from dcgrid_env.agents.training.config import ABOVE_0, WITHIN
from dcgrid_env.cli.main import parse
from dcgrid_env.core.commands.option_limits import LIMITS

ENTRIES = {line: member for line, member in COMMANDS.below("dcgrid") if isinstance(member, Entry)}


def numbers(kind):
    """The names of the fields that are numbers, or tuples of them."""
    for field, hint in typing.get_type_hints(kind).items():
        inner = [hint, *typing.get_args(hint)]
        if {int, float} & {*inner, *(part for one in inner for part in typing.get_args(one))}:
            yield field


@pytest.mark.parametrize("line", [line for line, entry in ENTRIES.items() if "train_command:" not in entry.where])
def test_every_number_of_a_command_has_a_limit(line):
    kind = ENTRIES[line].load()
    assert set(numbers(kind)) <= set(LIMITS)
    defaults = {field.name: field.default for field in dataclasses.fields(kind)}
    for name in numbers(kind):
        low, high = LIMITS[name]
        assert low < high < float("inf")
        default: Any = defaults[name]
        if isinstance(default, int | float):
            assert low <= default <= high


@pytest.mark.parametrize("line", [line for line, entry in ENTRIES.items() if "train_command:" in entry.where])
def test_every_number_of_a_training_has_a_limit(line):
    pytest.importorskip("torch")
    kind = ALGORITHMS[line.split()[-1]].configuration()
    without = {"hidden", "gains"}  # checked by themselves
    assert set(numbers(kind)) - without <= {*ABOVE_0, *WITHIN}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("capacity --feeder ieee33 --samples 1000000000", "samples: must be at most 10,000, got 1000000000"),
        ("run --episodes 1000000000", "episodes: must be at most 100,000, got 1000000000"),
        ("run --horizon 0", "horizon: must be at least 1, got 0"),
        ("check toy6 --jobs 1000000000", "workers: must be at most 4,096, got 1000000000"),
        ("evaluate x --seed -1", "seed: must be at least 0, got -1"),
        ("evaluate x --seed 99999999999999999999", "seed: must be at most 9,223,372,036,854,775,807"),
        ("benchmark --episodes 100001", "episodes: must be at most 100,000, got 100001"),
        ("capacity --feeder ieee33 --max-mw nan", "max_mw: must be at least 1e-06, got nan"),
        ("traces show code --duration-s 1e300", r"duration_s: must be at most 31,622,400.0, got 1e\+300"),
        ("traces record x --gpus 0 1000000", "gpus: must be at most 4,095, got 1000000"),
        ("train ppo --seeds 1000000000", "seeds: must be at most 10,000, got 1000000000"),
    ],
)
def test_a_number_beyond_its_limit_is_refused(words, message):
    with pytest.raises(ValueError, match=message):
        parse(words.split())
