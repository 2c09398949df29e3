"""Files that an OpenDSS script names: only those beneath the folder of its master file are read."""

from __future__ import annotations

from pathlib import Path

LARGEST_BYTES = 256 * 2**20
"""Size of a file beyond which it is not read."""


def file_beneath(root: Path, folder: Path, name: str) -> Path:
    """Return the real path of the file that a script in ``folder`` names.

    Backslashes also separate folders, and the case of a name is ignored, because scripts come from Windows.

    Raises
    ------
    ValueError
        If the path is outside ``root``, also through links, or is not a file.
    """
    path_text = name.strip().replace("\\", "/")
    if not path_text or path_text.startswith("~") or ":" in path_text:
        raise ValueError(f"{name!r} is no path of a file beneath the folder {root}")
    path = _locate(folder, path_text)
    real = path.resolve()
    if not real.is_relative_to(root):
        raise ValueError(
            f"{name!r} is not beneath the folder {root}; put it there, or give a folder with both by --root"
        )
    if not real.is_file():
        raise ValueError(f"there is no file {name!r} in {folder}")
    if real.stat().st_size > LARGEST_BYTES:
        raise ValueError(f"{name!r} has more than {LARGEST_BYTES // 2**20} MiB")
    if any(character in str(real) for character in "\"\n\r'@"):
        raise ValueError(f"{str(real)!r} holds quotes, a line end or @; rename the folder or the file")
    return real


def _locate(folder: Path, path_text: str) -> Path:
    path = Path("/") if path_text.startswith("/") else folder
    for part in Path(path_text.lstrip("/")).parts:
        there = path / part
        if not there.exists() and part != ".." and path.is_dir():
            there = next((one for one in sorted(path.iterdir()) if one.name.lower() == part.lower()), there)
        path = there
    return path


def text_of(path: Path) -> str:
    """The text of a script, UTF-8 or else Latin-1, in which every byte means something."""
    raw = path.read_bytes()
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")
