"""Installation hints for optional dependencies: the package is not on a registry, so every hint is for a clone."""


def from_clone(extra: str) -> str:
    """The command that installs an extra of pyproject.toml, to be run in a clone of the repository."""
    return f"in a clone of the repository: pip install -e '.[{extra}]'"
