"""batch() chooses between the processor and a GPU."""

from __future__ import annotations

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime.batch.cuda import Cuda
from nmpc_codegen.runtime.batch.device import DeviceBatch
from nmpc_codegen.runtime.batch.driver import check_threads
from nmpc_codegen.runtime.batch.many import Batch, check_number
from nmpc_codegen.runtime.controller import Controller


def check_request(number: int, device: str, threads: int | None) -> None:
    """Raise ControllerError if an argument of batch() is wrong."""
    check_number(number)
    check_threads(threads)
    if device not in ("cpu", "cuda"):
        raise ControllerError(f"device is {device!r}; allowed: 'cpu', 'cuda'")
    if device == "cuda" and threads is not None:
        raise ControllerError("threads are those of the processor; leave them out with device='cuda'")


def make(controller: Controller, number: int, device: str, threads: int | None) -> Batch:
    """Create many copies of a controller on the processor or on a GPU; see nmpc_codegen.batch()."""
    return Batch(controller, number, threads) if device == "cpu" else DeviceBatch(controller, number, Cuda())
