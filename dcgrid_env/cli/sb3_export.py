"""The command ``dcgrid export-sb3``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dcgrid_env.cli.command import Command
from dcgrid_env.cli.settings import Overrides
from dcgrid_env.cli.terminal import plain_console, say
from dcgrid_env.core.install import from_clone

SUFFIX = ".zip"
"""How the file of a Stable-Baselines3 model ends."""


@dataclass(frozen=True)
class ExportSb3(Command):
    """Convert a Stable-Baselines3 model into a policy file.

    The file needs neither torch nor trust.

    No object of the zip is unpickled without --trust: torch reads the weights as tensors alone, and what the network is
    stands beside them as text. PPO, A2C, SAC, TD3 and DDPG with MlpPolicy can be converted.
    """

    model: tyro.conf.Positional[Path]
    """Zip that model.save of Stable-Baselines3 wrote."""
    scenario: str
    """What it was trained on: the name of a scenario, path/to/file.toml, or path/to/file.py:function or
    package.module:function that makes your own. Its observation and action must be those of gymnasium.make, or of
    sb3_vec_env in the joint or the shared view."""
    set: Overrides = ()
    """Fields of the scenario that are to be otherwise, for instance --set horizon=60 sensing.noise_pu=0.005."""
    out: Path = Path("policy.safetensors")
    """File of the policy; its card is written beside it, ending in .json."""
    normalize: Path | None = None
    """File of VecNormalize.save where the model was trained behind it. It is pickle, and needs --trust. The zip of a
    PPO or A2C says whether it was; that of SAC, TD3 and DDPG does not."""
    trust: bool = False
    """Whether to unpickle the zip too, which runs whatever code it holds, and compare the policy's actions with those
    of Stable-Baselines3 on episodes of the training split."""

    def run(self) -> None:
        """Convert, compare where trusted, write, print. ValueError for what cannot be, before anything is written."""
        if self.out.suffix not in ("", ".safetensors"):
            raise ValueError(f"out is {str(self.out)!r}; a policy's file name ends in .safetensors")
        if self.normalize is not None and not self.trust:
            raise ValueError(
                f"normalize is {str(self.normalize)!r}, which is pickle, and unpickling runs whatever code a file "
                "holds; if you made it yourself or trust who did, add --trust"
            )
        try:
            self._run()
        except ImportError as error:
            raise ValueError(f"export-sb3 needs {error.name}; {from_clone('agents')}") from None

    def _run(self) -> None:
        from dcgrid_env.agents.from_sb3.sb3_policy import as_policy
        from dcgrid_env.agents.from_sb3.sb3_zip import read_actor
        from dcgrid_env.agents.training.validation import made_with
        from dcgrid_env.baselines.scenario_spec import ScenarioSpec

        spec, actor, normalisation = ScenarioSpec(self.scenario, self.set), read_actor(self.model), None
        if self.normalize is not None:
            from dcgrid_env.agents.from_sb3.sb3_controller import read_normalisation

            normalisation = read_normalisation(self.normalize)
            actor = actor._replace(is_normalised=normalisation is not None)
        try:
            policy = as_policy(actor, spec, made_with(), normalisation)
        except ValueError as error:
            raise ValueError(f"{self.model}: {error}") from None
        console = plain_console()
        if self.trust:
            from dcgrid_env.agents.from_sb3.sb3_controller import EPISODES, Sb3Controller, largest_difference

            largest = largest_difference(Sb3Controller(self.model, normalisation), policy, spec.make("train"))
            say(
                console,
                f"the largest difference from predict(deterministic=True) is {largest:.1e} in {EPISODES} episodes",
            )
        elif actor.is_normalised is None:
            say(console, "observations are taken as they are; behind VecNormalize the model needs --normalize")
        card = {"algorithm": f"sb3-{actor.algorithm}", "seed": actor.seed}
        path = policy.save(self.out, card)
        kinds = ", ".join(f"{name} {net.n_in} -> {net.n_out}" for name, net in policy.networks.items())
        say(console, f"{actor.algorithm} of Stable-Baselines3, networks: {kinds}")
        say(console, f"wrote {path} and .json; next: dcgrid evaluate {path}")


def require_trusted(model: Path, trust: bool, scenario: str) -> None:
    """ValueError, saying why and what does without, unless a Stable-Baselines3 zip is trusted."""
    if not trust:
        raise ValueError(
            f"policy {str(model)!r} is a zip of Stable-Baselines3, which is pickle, and unpickling runs whatever code "
            f"it holds; `dcgrid export-sb3 {model} --scenario {scenario}` converts its weights once without "
            "unpickling, and if you made it yourself or trust who did, --trust loads it as it is"
        )
