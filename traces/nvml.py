"""GPUs read through NVML, the management library of the NVIDIA driver: readings only, no setting is ever changed.

Power is the instantaneous reading where the GPU gives one. The older reading is a mean over the last second on most
GPUs since Ampere, which smooths away what a recording is for; `GpuReader.power_reading` is the one that is used.
Either is renewed at the GPU's own pace, which may be slower than it is asked.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from dcgrid_env.core.suggestions import from_clone
from dcgrid_env.traces.checks import TraceError

INSTANT = "NVML_FI_DEV_POWER_INSTANT"
USAGE = "nvmlDeviceGetPowerUsage"


@contextmanager
def started() -> Iterator[Any]:
    """The module pynvml with its library started, shut down at the end.

    Raises
    ------
    TraceError
        If the module, the driver or the library is missing.
    """
    try:
        nvml = importlib.import_module("pynvml")
    except ImportError as error:
        raise TraceError(f"recording needs the package nvidia-ml-py; install it {from_clone('record')}") from error
    try:
        nvml.nvmlInit()
    except nvml.NVMLError as error:
        raise TraceError(f"NVML does not start ({error}); recording needs an NVIDIA GPU and its driver") from error
    try:
        yield nvml
    finally:
        nvml.nvmlShutdown()


class GpuReader:
    """One GPU; TraceError if it cannot be opened or gives no power reading."""

    def __init__(self, nvml: Any, index: int) -> None:
        self._nvml, self.index = nvml, index
        try:
            self._handle = nvml.nvmlDeviceGetHandleByIndex(index)
            self.name: str = nvml.nvmlDeviceGetName(self._handle)
        except nvml.NVMLError as error:
            raise TraceError(f"GPU {index} cannot be opened ({error}); name others with gpus") from error
        self.power_reading = INSTANT
        try:
            self._power_mw()
        except nvml.NVMLError:
            self.power_reading = USAGE
            try:
                self.power_w()
            except TraceError as error:
                raise TraceError(f"{error}; leave it out: name others with gpus") from error

    def power_w(self) -> float:
        """Power drawn now, W; TraceError if the GPU does not give it (any more)."""
        try:
            return self._power_mw() / 1000
        except self._nvml.NVMLError as error:
            raise TraceError(f"GPU {self.index} ({self.name}) gives no power reading ({error})") from error

    def _power_mw(self) -> int:
        nvml = self._nvml
        if self.power_reading == USAGE:
            return nvml.nvmlDeviceGetPowerUsage(self._handle)
        (field,) = nvml.nvmlDeviceGetFieldValues(self._handle, [nvml.NVML_FI_DEV_POWER_INSTANT])
        if field.nvmlReturn != nvml.NVML_SUCCESS:
            raise nvml.NVMLError(field.nvmlReturn)
        return field.value.uiVal

    def sm_clock_mhz(self) -> int | None:
        """Return the current clock of the processors, MHz; None if it cannot be read."""
        return self._optional("nvmlDeviceGetClockInfo", self._nvml.NVML_CLOCK_SM)

    def facts(self) -> dict[str, Any]:
        """Return the GPU's identity and current settings as JSON values; None for those it does not report."""
        nvml = self._nvml
        limit_mw = self._optional("nvmlDeviceGetEnforcedPowerLimit")
        return {
            "index": self.index,
            "name": self.name,
            "uuid": self._optional("nvmlDeviceGetUUID"),
            "power_reading": self.power_reading,
            "power_limit_w": None if limit_mw is None else limit_mw / 1000,
            "max_sm_clock_mhz": self._optional("nvmlDeviceGetMaxClockInfo", nvml.NVML_CLOCK_SM),
            "max_memory_clock_mhz": self._optional("nvmlDeviceGetMaxClockInfo", nvml.NVML_CLOCK_MEM),
            "memory_clock_mhz": self._optional("nvmlDeviceGetClockInfo", nvml.NVML_CLOCK_MEM),
        }

    def _optional(self, function: str, *arguments: int) -> Any:
        try:
            return getattr(self._nvml, function)(self._handle, *arguments)
        except self._nvml.NVMLError:
            return None


def open_gpus(nvml: Any, indices: Sequence[int] | None = None) -> list[GpuReader]:
    """Return the GPUs of these NVML indices, by default all of the machine.

    Raises
    ------
    TraceError
        If the machine has no GPU, an index does not exist or is repeated, or a GPU gives no power reading.
    """
    count = nvml.nvmlDeviceGetCount()
    if count == 0:
        raise TraceError("the machine has no NVIDIA GPU; record where there is one")
    chosen = list(range(count)) if indices is None else list(indices)
    if not chosen or len(set(chosen)) < len(chosen):
        raise TraceError(f"gpus is {chosen}; name at least one and none twice")
    for index in chosen:
        if not 0 <= index < count:
            raise TraceError(f"GPU {index} is not there; the machine has 0 to {count - 1}")
    return [GpuReader(nvml, index) for index in chosen]
