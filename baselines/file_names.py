"""Names of files after what users name."""

from __future__ import annotations

import hashlib
import re

_LONGEST = 40


def file_name(text: str) -> str:
    """A text as the name of a file or folder: itself if it is plain, else its letters and digits with a hash."""
    safe = re.sub(r"[^A-Za-z0-9-]+", "_", text)[-_LONGEST:]
    if safe == text and text:
        return safe
    return f"{safe}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"  # two that differ in signs alone stay apart
