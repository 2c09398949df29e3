"""Origin of a trace, so a result can state its data source."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, is_dataclass
from typing import Any

from dcgrid_env.core.checked import Plain


@dataclass(frozen=True)
class Provenance:
    """A generator with its parameters and seed, or a file with its hash; a field that does not apply is left out."""

    name: str = ""
    """The generator, or the file's name without its folder."""
    seed: int | None = None
    parameters: dict[str, Any] = field(default_factory=dict)
    """A generator's parameters, or what a recorder noted; JSON values."""
    sha256: str = ""
    """SHA-256 of the file's bytes, hexadecimal."""
    licence: str = ""
    citation: str = ""

    def record(self) -> dict[str, Any]:
        """Return the fields that apply, as JSON values."""
        return {name: value for name, value in asdict(self).items() if value not in ("", None, {})}

    def __str__(self) -> str:
        parts = [self.name or "unknown origin"]
        if self.seed is not None:
            parts.append(f"seed {self.seed}")
        if self.sha256:
            parts.append(f"sha256 {self.sha256[:12]}")
        if self.licence:
            parts.append(self.licence)
        return ", ".join(parts)


def generated(generator: str, seed: int, duration_s: float, **params: object) -> Provenance:
    """Provenance of a generated trace; dataclasses among `params` are taken apart."""
    parameters = {"duration_s": float(duration_s)} | {name: _to_plain(value) for name, value in params.items()}
    return Provenance(f"generator {generator}", seed=int(seed), parameters=parameters)


def _to_plain(value: object) -> Plain:
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value
