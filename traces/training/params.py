"""Parameters of training jobs: lengths, rates and levels, each with its source or marked as a choice."""

from dataclasses import dataclass, fields

from dcgrid_env.traces.checks import TraceError
from dcgrid_env.traces.time_grid import IDLE_SHARE, check_range
from dcgrid_env.traces.training.smoothing import PowerSmoothing

_SHARE = (IDLE_SHARE, 1.0)

# Range of each field, both ends allowed. Iterations beyond 5 Hz would not show on the grid of 0.1 s.
_RANGES: dict[str, tuple[float, float]] = {
    "n_slots": (1, 64),
    "slot_evenness": (0.1, 1e6),
    "job_mean_s": (10.0, 1e9),
    "gap_mean_s": (1.0, 1e9),
    "failure_mean_s": (10.0, 1e9),
    "restart_s": (1.0, 1e6),
    "loading_s": (0.1, 1e6),
    "ramp_s": (0.1, 600.0),
    "iteration_hz": (0.01, 5.0),
    "iteration_spread": (0.0, 0.2),
    "exchange_fraction": (0.01, 0.99),
    "compute_share": _SHARE,
    "exchange_share": _SHARE,
    "waiting_share": _SHARE,
    "checkpoint_every_s": (1.0, 1e9),
    "checkpoint_s": (0.1, 1e4),
    "stall_every_s": (1.0, 1e9),
    "stall_s": (0.01, 1e3),
}


@dataclass(frozen=True)
class TrainingParams:
    """Parameters of training jobs; pairs are the range from which each job draws, shares are of the rating.

    Sources: [1] arXiv 2508.14318, [2] arXiv 2407.21783, [3] Chen and Zhang, arXiv 2507.06416, Fig. 1. A field without
    one is a choice, made so that an hour holds a few of each event. A field out of its range raises TraceError.
    """

    n_slots: tuple[int, int] = (1, 3)
    """Parts of the site that run one job each at a time; drawn once for the site."""
    slot_evenness: float = 4.0
    """Concentration of the Dirichlet law of the parts' sizes: at 1 any split is as likely, at 1e6 all are even."""
    job_mean_s: float = 1800.0
    """Mean of the exponential running time of a job, s."""
    gap_mean_s: float = 180.0
    """Mean of the exponential time from a job's end to the next one's start, s."""
    failure_mean_s: float = 11_000.0
    """Running time between failures, s; 419 unexpected interruptions in 54 days on 16,384 GPUs [2]; 1e9 is never."""
    restart_s: tuple[float, float] = (120.0, 600.0)
    """From a failure until the job loads again, s."""
    loading_s: tuple[float, float] = (5.0, 30.0)
    """Loading of the model and the first data when a job starts or restarts, s."""
    ramp_s: tuple[float, float] = (1.0, 8.0)
    """From the first iteration to full power, s; that all GPUs of a job ramp together is from [3]."""
    iteration_hz: tuple[float, float] = (0.2, 3.0)
    """Iterations a second [1], drawn evenly in the logarithm."""
    iteration_spread: float = 0.02
    """Standard deviation of an iteration's length over its mean."""
    exchange_fraction: tuple[float, float] = (0.1, 0.3)
    """Part of an iteration in which gradients are exchanged."""
    compute_share: tuple[float, float] = (0.9, 1.0)
    """Draw while computing: near the rating [1]."""
    exchange_share: tuple[float, float] = (0.28, 0.4)
    """Draw while gradients are exchanged or a checkpoint is written: near idle [1]."""
    waiting_share: tuple[float, float] = (0.25, 0.32)
    """Draw while the GPUs wait for data: between the idle floor and the exchange."""
    checkpoint_every_s: tuple[float, float] = (200.0, 600.0)
    """Computing and exchange between checkpoints, s."""
    checkpoint_s: tuple[float, float] = (3.0, 15.0)
    """Writing of one checkpoint, s."""
    stall_every_s: tuple[float, float] = (60.0, 1800.0)
    """Mean time between stalls of the input pipeline, s, drawn evenly in the logarithm."""
    stall_s: tuple[float, float] = (0.3, 5.0)
    """Length of one stall, s, drawn evenly in the logarithm; [3] shows dips of under a second."""
    smoothing: PowerSmoothing | None = None
    """Power smoothing in the GPUs; None is off, as in GPUs before it existed."""

    def __post_init__(self) -> None:
        for field in fields(self):
            if field.name in _RANGES:
                check_range(self, field, _RANGES[field.name])
        if not all(isinstance(n, int) for n in self.n_slots):
            raise TraceError(f"TrainingParams.n_slots = {self.n_slots} is not a pair of integers")
        if not (self.smoothing is None or isinstance(self.smoothing, PowerSmoothing)):
            raise TraceError(f"TrainingParams.smoothing = {self.smoothing!r} is not a PowerSmoothing or None")
        for name in ("exchange_share", "waiting_share"):
            if getattr(self, name)[1] > self.compute_share[0]:
                raise TraceError(
                    f"TrainingParams.{name} = {getattr(self, name)} reaches above compute_share {self.compute_share}; "
                    "give draws that do not exceed the lowest draw while computing"
                )
