"""The command ``dcgrid export-sb3``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dcgrid_env.baselines.scenario_spec import ScenarioSpec
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.settings import Overrides
from dcgrid_env.core.commands.terminal import plain_console, say
from dcgrid_env.core.suggestions import from_clone

SUFFIX = ".zip"
"""File name ending of Stable-Baselines3 models."""


@dataclass(frozen=True)
class ExportSb3(Command):
    """Convert a Stable-Baselines3 model into a policy file.

    The policy file can be used without torch and without --trust.

    Without --trust, nothing in the zip is unpickled: torch reads only the weights, and the network structure is read
    from text. The command converts PPO, A2C, SAC, TD3 and DDPG with MlpPolicy.
    """

    model: tyro.conf.Positional[Path]
    """Zip file written by model.save of Stable-Baselines3."""
    scenario: str | None = None
    """Scenario of the training: a name (dcgrid list), path/to/file.toml, path/to/file.py:function or
    package.module:function. Default: the one that the model contains, if it was trained on sb3_vec_env. Other models
    must use the spaces of gymnasium.make."""
    set: Overrides = ()
    """Scenario fields to override, for example --set horizon=60 sensing.noise_pu=0.005."""
    out: Path = Path("policy.safetensors")
    """Policy file to write. Its card is written next to it with the ending .json."""
    normalize: Path | None = None
    """File of VecNormalize.save, if the model was trained with it. It is a pickle file and requires --trust. Zips of
    PPO and A2C record whether it was used; those of SAC, TD3 and DDPG do not."""
    trust: bool = False
    """Unpickle the zip, which runs any code in it, and compare the policy's actions with those of Stable-Baselines3 on
    training episodes."""

    def run(self) -> None:
        """Convert, compare if trusted, write and print; raise ValueError before writing if a setting is invalid."""
        if self.out.suffix not in ("", ".safetensors"):
            raise ValueError(f"out: must end in .safetensors, got {str(self.out)!r}")
        if self.normalize is not None and not self.trust:
            raise ValueError(
                f"normalize: must be trusted, got the pickle file {str(self.normalize)!r}; unpickling runs any code in "
                "the file; add --trust if you trust its author"
            )
        try:
            self._run()
        except ImportError as error:
            raise ValueError(f"export-sb3 needs {error.name}; {from_clone('agents')}") from None

    def _run(self) -> None:
        from dcgrid_env.agents.from_sb3.sb3_policy import as_policy, named_scenario
        from dcgrid_env.agents.from_sb3.sb3_zip import read_actor

        actor, normalisation = read_actor(self.model), None
        where = self.scenario or named_scenario(actor.form)
        if where is None:
            raise ValueError(f"{self.model}: names no scenario of dcgrid list; add --scenario")
        spec = ScenarioSpec(where, self.set)
        if self.normalize is not None:
            from dcgrid_env.agents.from_sb3.sb3_controller import read_normalisation

            normalisation = read_normalisation(self.normalize)
            actor = actor._replace(is_normalised=False)
        trained = spec.make("train")
        try:
            policy = as_policy(actor, trained, normalisation, spec.label)
        except ValueError as error:
            raise ValueError(f"{self.model}: {error}") from None
        console = plain_console()
        if self.trust:
            from dcgrid_env.agents.from_sb3.sb3_controller import EPISODES, largest_difference, loaded

            largest = largest_difference(loaded(self.model, normalisation), policy, trained)
            say(
                console,
                f"largest difference from predict(deterministic=True): {largest:.1e} in {EPISODES} episodes",
            )
        elif actor.is_normalised is None and actor.network.mean is None:
            say(console, "observations are not normalised; add --normalize if the model was trained with VecNormalize")
        path = policy.save(self.out, actor.card)
        kinds = ", ".join(f"{name} {net.n_in} -> {net.n_out}" for name, net in policy.networks.items())
        say(console, f"{actor.algorithm} of Stable-Baselines3, networks: {kinds}")
        say(console, f"wrote {path} and .json; next: dcgrid evaluate {path}")
