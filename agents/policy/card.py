"""Policy card: origin and results of a policy, stored in NAME.json next to the weights in NAME.safetensors."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

from dcgrid_env.agents.policy.input_range import InputRange
from dcgrid_env.agents.policy.neural_network import PolicyError
from dcgrid_env.core.checked import Plain, finite
from dcgrid_env.core.files import write_json
from dcgrid_env.core.user_files import read_json
from dcgrid_env.traces import ALL_SPLITS

FORMAT = 3
"""Version of the card's format: 3 has costs on test and on validation of every seed, 2 had ``inputs`` and the interval
over seeds and episodes, 1 had neither."""
MOST_MIB = 16
"""Maximum size of a file that is read."""
ORIGIN_FIELDS = ("algorithm", "scenario", "seed", "command", "training_s", "validation_J")
"""Fields that the caller may set; the other fields are computed."""


@dataclass(frozen=True)
class Scored:
    """Results of a policy on episodes that were not used for training or selection."""

    scenario: str
    """Name of the preset, which can differ from the training preset."""
    split: str
    episodes: int
    """Seeds 0, 1, .."""
    scenario_hash: str
    """Hash of the scenario on that split."""
    J: float
    """Mean over the episodes, as the next two."""
    delay_mean_s: float
    droop_delay_mean_s: float
    """Mean delay under the tuned droop."""
    score: tuple[float, float, float]
    """Score and the bounds of its 95 % interval over episodes; the tuned droop has score 0, hindsight 1."""
    seeds: tuple[int, ...]
    """Training seeds of the same command that were scored; the policy is the one with the best validation J."""
    seed_scores: tuple[float, ...]
    """Their scores, in the same order."""
    over_seeds: tuple[float, float, float] | None = None
    """Mean of those scores and the ends of its 95 % interval over seeds and episodes (``score.mean_over_seeds``); none
    for one seed."""
    droop_J: float | None = None
    """Mean J of the tuned droop, of which a policy saves a share."""
    seed_J: tuple[float, ...] | None = None
    """Mean J of each seed's policy, in the order of ``seeds``; none in formats 1 and 2."""
    seed_validation_J: tuple[float, ...] | None = None
    """Mean J of each on the validation episodes by which the best was selected; none where it was not recorded."""

    def __post_init__(self) -> None:
        _check(self, str, "scenario", "split", "scenario_hash")
        _check(self, int, "episodes")
        _check(self, float, "J", "delay_mean_s", "droop_delay_mean_s")
        _check_all(self, float, "score", 3)
        _check_all(self, int, "seeds")
        _check_all(self, float, "seed_scores", len(self.seeds))
        _check(self, (float, type(None)), "droop_J")
        for name, n in (("over_seeds", 3), ("seed_J", len(self.seeds)), ("seed_validation_J", len(self.seeds))):
            if getattr(self, name) is not None:
                _check_all(self, float, name, n)
        _at_least(self, 1, "episodes")
        _at_least(self, 0, "delay_mean_s", "droop_delay_mean_s")
        if self.split not in ALL_SPLITS:
            raise PolicyError(f"card: split is {self.split!r}; choose one of {', '.join(ALL_SPLITS)}")
        if not re.fullmatch("[0-9a-f]{16}", self.scenario_hash):
            raise PolicyError(f"card: scenario_hash is {self.scenario_hash!r}; give 16 hexadecimal digits")
        if not self.seeds or len(set(self.seeds)) < len(self.seeds) or min(self.seeds) < 0:
            raise PolicyError(f"card: seeds is {self.seeds!r}; give seeds from 0, each once")
        for name in ("score", "over_seeds"):
            value, low, high = getattr(self, name) or (0, 0, 0)
            if not low <= value <= high:
                raise PolicyError(f"card: {name} is {value} from {low} to {high}; give an interval around it")
        mean = sum(self.seed_scores) / len(self.seeds)
        if self.over_seeds is not None and not math.isclose(self.over_seeds[0], mean, rel_tol=1e-9, abs_tol=1e-9):
            raise PolicyError(f"card: over_seeds is {self.over_seeds[0]}, the mean of seed_scores is {mean}")


@dataclass(frozen=True)
class Card:
    """Card of a policy.

    Raises
    ------
    PolicyError
        For a field of the wrong type, a figure that is not finite, or fields that contradict each other, naming it.
    """

    version: str
    """Version of dcgrid-env that created the policy."""
    n_parameters: int
    """Number of parameters, including those of the normalisation."""
    sha256: str
    """``Policy.sha256``: of weights and settings, as in the header of the weights' file."""
    algorithm: str = ""
    scenario: str = ""
    """Name of the training scenario."""
    command: str = ""
    """Command that reproduces the policy with the bundled settings of its scenario (``settings``)."""
    seed: int | None = None
    """Random seed of the training."""
    training_s: float | None = None
    """Wall-clock time of the training."""
    validation_J: float | None = None
    """Mean J on the validation episodes used for selection."""
    scored: Scored | None = None
    inputs: Mapping[str, InputRange] | None = None
    """Range of what each network was given on the training split, with the nameplate figures, by the network's name;
    none where that was not recorded."""
    format: int = FORMAT
    """Version of the card's format."""

    def __post_init__(self) -> None:
        _check(self, int, "format")
        if not 1 <= self.format <= FORMAT:
            raise PolicyError(f"card: format is {self.format}, this dcgrid reads 1 to {FORMAT}; update it")
        for name, input_range in (self.inputs or {}).items():
            _check_range(name, input_range)
        _check(self, str, "version", "sha256", "algorithm", "scenario", "command")
        _check(self, int, "n_parameters")
        _check(self, (int, type(None)), "seed")
        _check(self, (float, type(None)), "training_s", "validation_J")
        if not re.fullmatch("[0-9a-f]{64}", self.sha256):
            raise PolicyError(f"card: sha256 is {self.sha256!r}; give 64 hexadecimal digits")
        _at_least(self, 0, "n_parameters", "seed", "training_s")
        if self.scored is not None and self.seed is not None:
            self._check_seed(self.seed, self.scored)

    def _check_seed(self, seed: int, scored: Scored) -> None:
        """Raise PolicyError unless the results belong to the policy's seed."""
        if seed not in scored.seeds:
            raise PolicyError(f"card: seed is {seed}; give one of scored.seeds, {', '.join(map(str, scored.seeds))}")
        pairs = (
            ("scored.score", scored.score[0], "seed_scores"),
            ("scored.J", scored.J, "seed_J"),
            ("validation_J", self.validation_J, "seed_validation_J"),
        )
        for name, value, column in pairs:
            of_seeds = getattr(scored, column)
            if of_seeds is None:
                continue
            there = of_seeds[scored.seeds.index(seed)]
            agrees = value is not None and math.isclose(
                value, there, rel_tol=1e-6, abs_tol=1e-9
            )  # computed in two ways
            if not agrees:
                raise PolicyError(f"card: {name} is {value}, {column} has {there} for seed {seed}; give one figure")

    @classmethod
    def of(cls, sha256: str, n_parameters: int, origin: Mapping[str, Any]) -> Self:
        """The card of a policy that was just made; ``origin`` has some of ``ORIGIN_FIELDS``, PolicyError for others."""
        unknown = sorted(set(origin) - set(ORIGIN_FIELDS))
        if unknown:
            raise PolicyError(f"card: {unknown[0]} is no field of it; give some of {', '.join(ORIGIN_FIELDS)}")
        return cls(version("dcgrid-env"), n_parameters, sha256, **origin)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a card; raise PolicyError, with the file, if it is invalid, and OSError if it cannot be opened."""
        path = Path(path)
        fields = read_json(path, PolicyError, "give a card that Policy.save wrote", MOST_MIB)
        try:
            if fields.get("scored") is not None:
                fields["scored"] = Scored(**{name: _frozen(value) for name, value in fields["scored"].items()})
            if fields.get("inputs") is not None:
                fields["inputs"] = {name: _range_of(stored) for name, stored in fields["inputs"].items()}
            return cls(**{"format": 1} | fields)
        except (ValueError, TypeError, AttributeError) as error:
            raise PolicyError(f"{path}: not a policy's card ({error}); give one that Policy.save wrote") from None

    def save(self, path: str | Path) -> None:
        """Write the card as JSON, atomically."""
        about = dataclasses.asdict(self)
        if self.inputs is not None:
            about["inputs"] = {name: input_range._asdict() for name, input_range in self.inputs.items()}
        write_json(Path(path), about)


def card_of(weights: Path, policy: Any) -> Card | None:
    """Return the card next to a policy's file, or None; raise PolicyError if it belongs to another policy."""
    path = weights.with_suffix(".json")
    if not path.is_file():
        return None
    card = Card.load(path)
    for name, value in (
        ("sha256", policy.sha256), ("n_parameters", policy.n_parameters), ("scenario", policy.trained_on),
    ):  # fmt: skip
        if getattr(card, name) != value:
            raise PolicyError(
                f"{path}: {name} is {getattr(card, name)!r}, that of {weights.name} is {value!r}; give the card that "
                "was saved with it, or delete this one"
            )
    if card.inputs is not None and set(card.inputs) != set(policy.networks):
        raise PolicyError(f"{path}: inputs are of {sorted(card.inputs)}, the networks are {sorted(policy.networks)}")
    return card


def _range_of(stored: Mapping[str, Any]) -> InputRange:
    return InputRange(**{name: _frozen(value) for name, value in stored.items()})


def _frozen(value: object) -> Plain:
    return tuple(value) if isinstance(value, list) else value


def _check(card: Scored | Card, kind: type | tuple[type, ...], *names: str) -> None:
    for name in names:
        _check_one(name, getattr(card, name), kind)


def _check_range(name: str, input_range: InputRange) -> None:
    """PolicyError unless a network's range has a name and two finite ends, in order, for each input."""
    said = f"card: inputs of {name}"
    if not all(isinstance(part, tuple) and len(part) == len(input_range.fields) for part in input_range):
        raise PolicyError(f"{said} have fields, low and high of different lengths; give one of each for each input")
    for field, low, high in zip(*input_range, strict=True):
        ends = (low, high)
        if not isinstance(field, str) or not all(map(finite, ends)) or low > high:
            raise PolicyError(
                f"{said} are {field!r} from {low!r} to {high!r}; give a name and two finite ends in order"
            )


def _check_all(card: Scored | Card, kind: type, name: str, n: int | None = None) -> None:
    values = getattr(card, name)
    if not isinstance(values, tuple) or len(values) != (len(values) if n is None else n):
        raise PolicyError(f"card: {name} is {values!r}; give {'some' if n is None else n} figures")
    for value in values:
        _check_one(name, value, kind)


def _check_one(name: str, value: object, kind: type | tuple[type, ...]) -> None:
    kinds = kind if isinstance(kind, tuple) else (kind,)
    allowed = (*kinds, int) if float in kinds else kinds
    expected = " or ".join("none" if k is type(None) else k.__name__ for k in kinds)
    if not isinstance(value, allowed) or isinstance(value, bool):
        raise PolicyError(f"card: {name} is {value!r}; give {expected}")
    if isinstance(value, int | float) and not finite(value):
        raise PolicyError(f"card: {name} is {value}; give a finite figure")
    if isinstance(value, str) and not value.isprintable():
        raise PolicyError(f"card: {name} is {value!r}; give one line of printable text")


def _at_least(card: Scored | Card, least: int, *names: str) -> None:
    for name in names:
        value = getattr(card, name)
        if value is not None and value < least:
            raise PolicyError(f"card: {name} is {value}; give at least {least}")
