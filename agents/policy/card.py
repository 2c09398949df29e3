"""Policy card: origin and results of a policy, stored in NAME.json next to the weights in NAME.safetensors."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from dcgrid_env.agents.policy.input_range import InputRange
from dcgrid_env.agents.policy.neural_network import PolicyError
from dcgrid_env.core.files import write_json
from dcgrid_env.core.user_files import read_json

FORMAT = 3
"""Version of the card's format: 3 has costs of every seed, 2 had ``inputs`` and the interval over seeds, 1 neither."""
MOST_MIB = 16
"""Maximum size of a file that is read."""
ORIGIN_FIELDS = ("algorithm", "scenario", "seed", "command", "training_s", "validation_J")
"""Fields that the caller may set; the other fields are computed."""
STRICT = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)


def _line(text: str) -> str:
    if not text.isprintable():
        raise ValueError("give one line of printable text")
    return text


def _interval(figures: tuple[float, float, float]) -> tuple[float, float, float]:
    value, low, high = figures
    if not low <= value <= high:
        raise ValueError("give an interval around its value")
    return figures


def _in_order(found: InputRange) -> InputRange:
    ends = zip(found.low, found.high, strict=False)
    if len({len(part) for part in found}) > 1 or not all(low <= high for low, high in ends):
        raise ValueError("give a name and two ends in order for each input")
    return found


def _readable(number: int) -> int:
    if not 1 <= number <= FORMAT:
        raise ValueError(f"this dcgrid reads 1 to {FORMAT}; update it")
    return number


Line = Annotated[str, AfterValidator(_line)]
Interval = Annotated[tuple[float, float, float], AfterValidator(_interval)]
Duration = Annotated[float, Field(ge=0.0)]
Count = Annotated[int, Field(ge=0)]


@dataclass(frozen=True, config=STRICT)
class Scored:
    """Results of a policy on episodes that were not used for training or selection."""

    scenario: Line
    """Name of the preset, which can differ from the training preset."""
    split: Literal["train", "validation", "test", "ood"]
    episodes: Annotated[int, Field(ge=1)]
    """Seeds 0, 1, .."""
    scenario_hash: Annotated[str, Field(pattern="^[0-9a-f]{16}$")]
    """Hash of the scenario on that split."""
    J: float
    """Mean over the episodes, as the next two."""
    delay_mean_s: Duration
    droop_delay_mean_s: Duration
    """Mean delay under the tuned droop."""
    score: Interval
    """Score and the bounds of its 95 % interval over episodes; the tuned droop has score 0, hindsight 1."""
    seeds: Annotated[tuple[Count, ...], Field(min_length=1)]
    """Training seeds of the same command that were scored; the policy is the one with the best validation J."""
    seed_scores: tuple[float, ...]
    """Their scores, in the same order."""
    over_seeds: Interval | None = None
    """Mean of those scores and the ends of its 95 % interval over seeds and episodes (``score.mean_over_seeds``); none
    for one seed."""
    droop_J: float | None = None
    """Mean J of the tuned droop, of which a policy saves a share."""
    seed_J: tuple[float, ...] | None = None
    """Mean J of each seed's policy, in the order of ``seeds``."""
    seed_validation_J: tuple[float, ...] | None = None
    """Mean J of each on the validation episodes by which the best was selected; none where it was not recorded."""

    def __post_init__(self) -> None:
        n = len(self.seeds)
        if len(set(self.seeds)) < n:
            raise ValueError(f"seeds is {self.seeds!r}; give each once")
        for name in ("seed_scores", "seed_J", "seed_validation_J"):
            figures = getattr(self, name)
            if figures is not None and len(figures) != n:
                raise ValueError(f"{name} is {figures!r}; give {n} figures")
        mean = sum(self.seed_scores) / n
        if self.over_seeds is not None and not math.isclose(self.over_seeds[0], mean, rel_tol=1e-9, abs_tol=1e-9):
            raise ValueError(f"over_seeds is {self.over_seeds[0]}, the mean of seed_scores is {mean}")


@dataclass(frozen=True, config=STRICT)
class Card:
    """Card of a policy.

    Raises
    ------
    pydantic.ValidationError
        A ValueError, for a field of the wrong type, a figure that is not finite, or fields that contradict each other.
    """

    version: Line
    """Version of dcgrid-env that created the policy."""
    n_parameters: Count
    """Number of parameters, including those of the normalisation."""
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    """``Policy.sha256``: of weights and settings, as in the header of the weights' file."""
    algorithm: Line = ""
    scenario: Line = ""
    """Name of the training scenario."""
    command: Line = ""
    """Command that reproduces the policy with the bundled settings of its scenario (``settings``)."""
    seed: Count | None = None
    """Random seed of the training."""
    training_s: Duration | None = None
    """Wall-clock time of the training."""
    validation_J: float | None = None
    """Mean J on the validation episodes used for selection."""
    scored: Scored | None = None
    inputs: dict[str, Annotated[InputRange, AfterValidator(_in_order)]] | None = None
    """Range of what each network was given on the training split, with the nameplate figures, by the network's name;
    none where that was not recorded."""
    format: Annotated[int, AfterValidator(_readable)] = FORMAT
    """Version of the card's format."""

    def __post_init__(self) -> None:
        scored, seed = self.scored, self.seed
        if scored is None or seed is None:
            return
        if seed not in scored.seeds:
            raise ValueError(f"seed is {seed}; give one of scored.seeds, {', '.join(map(str, scored.seeds))}")
        for name, value, column in (
            ("scored.score", scored.score[0], "seed_scores"),
            ("scored.J", scored.J, "seed_J"),
            ("validation_J", self.validation_J, "seed_validation_J"),
        ):
            if (of_seeds := getattr(scored, column)) is None:
                continue
            there = of_seeds[scored.seeds.index(seed)]
            # computed in two ways
            if value is None or not math.isclose(value, there, rel_tol=1e-6, abs_tol=1e-9):
                raise ValueError(f"{name} is {value}, {column} has {there} for seed {seed}; give one figure")

    @classmethod
    def of(cls, sha256: str, n_parameters: int, origin: Mapping[str, Any]) -> Self:
        """The card of a policy that was just made; ``origin`` has some of ``ORIGIN_FIELDS``, PolicyError for others."""
        unknown = sorted(set(origin) - set(ORIGIN_FIELDS))
        if unknown:
            raise PolicyError(f"card: {unknown[0]} is no field of it; give some of {', '.join(ORIGIN_FIELDS)}")
        try:
            return cls(version("dcgrid-env"), n_parameters, sha256, **origin)
        except ValidationError as error:
            raise PolicyError(f"card: {_first(error)}") from None

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a card; raise PolicyError, with the file, if it is invalid, and OSError if it cannot be opened."""
        fields = read_json(Path(path), PolicyError, "give a card that Policy.save wrote", MOST_MIB)
        if isinstance(fields, dict):
            fields = {"format": 1} | fields
        try:
            return TypeAdapter(cls).validate_json(json.dumps(fields))
        except ValidationError as error:
            raise PolicyError(
                f"{path}: not a policy's card ({_first(error)}); give one that Policy.save wrote"
            ) from None

    def save(self, path: str | Path) -> None:
        """Write the card as JSON, atomically."""
        about = dataclasses.asdict(self)
        if self.inputs is not None:
            about["inputs"] = {name: input_range._asdict() for name, input_range in self.inputs.items()}
        write_json(Path(path), about)


def _first(error: ValidationError) -> str:
    """Return the first error of a card on one line, with its field and value."""
    first = error.errors(include_url=False)[0]
    said = first["msg"].removeprefix("Value error, ")
    field, value = ascii(".".join(map(str, first["loc"])))[1:-1], ascii(first["input"])[:80]
    return f"{field} is {value}; {said[:1].lower()}{said[1:]}" if field else said


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
