"""How what is optional is installed: the package is on no registry, so that every hint is for a clone."""


def from_clone(extra: str) -> str:
    """The command that installs an extra of pyproject.toml, to be run in a clone of the repository."""
    return f"in a clone of the repository: pip install -e '.[{extra}]'"
