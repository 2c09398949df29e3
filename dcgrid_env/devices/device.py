"""What a group of devices is: its parameters, its state and a pure step, and what it says of itself."""

from __future__ import annotations

from typing import Any

Device = Any
