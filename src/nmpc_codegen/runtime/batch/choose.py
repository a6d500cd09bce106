"""The batch for a device."""

from __future__ import annotations

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime.batch.cuda import Cuda
from nmpc_codegen.runtime.batch.device import DeviceBatch
from nmpc_codegen.runtime.batch.many import Batch
from nmpc_codegen.runtime.controller import Controller


def make(controller: Controller, number: int, device: str, threads: int | None) -> Batch:
    """Many copies of a controller on the processor or on a GPU; see nmpc_codegen.batch()."""
    if device not in ("cpu", "cuda"):
        raise ControllerError(f"device is {device!r}; allowed: 'cpu', 'cuda'")
    if device == "cuda" and threads is not None:
        raise ControllerError("threads are those of the processor; leave them out with device='cuda'")
    return Batch(controller, number, threads) if device == "cpu" else DeviceBatch(controller, number, Cuda())
