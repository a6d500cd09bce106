"""The controls of a target are compared with those of the host.

A sample agrees if the statuses are equal and |u - u_host| <= tolerance * range for every control.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from nmpc_codegen.firmware.emulate import Outcome, emulate
from nmpc_codegen.firmware.image import MOST_STACK, build
from nmpc_codegen.firmware.process import run_process
from nmpc_codegen.firmware.recording import TOLERANCE, Array, Recording
from nmpc_codegen.firmware.toolchain import Level
from nmpc_codegen.targets import Target


@dataclass(frozen=True, eq=False)
class Verdict:
    """A verdict is the outcome of the comparison.

    ``mismatches`` are the samples that do not agree, ``example`` describes the first one; ``bits`` is the number of
    samples in which u differs in some bit.
    """

    run: Outcome
    samples: int
    tolerance: float
    error: float  # the largest |u - u_host| / range
    mismatches: tuple[int, ...]
    statuses: int  # samples with another status
    bits: int
    example: str = ""

    @property
    def passed(self) -> bool:
        return not self.mismatches

    def as_dict(self) -> dict[str, object]:
        """Return the outcome as a JSON object."""
        return {
            "samples": self.samples,
            "mismatches": len(self.mismatches),
            "status_differs": self.statuses,
            "bit_mismatches": self.bits,
            "largest_difference_over_range": self.error,
            "tolerance": self.tolerance,
            **self.run.measured,
        }


def verify(
    package: Mapping[str, str],
    name: str,
    recording: Recording,
    target: Target,
    level: Level = "O2",
    stack_bytes: int = MOST_STACK,
) -> Verdict:
    """Replay the recording on the emulated target and compare.

    ``stack_bytes`` is the expected stack of a call on a board, with the optimisation ``level``.

    Raises:
        BuildError: a tool is missing or fails.
    """
    with TemporaryDirectory() as folder:
        if target.board is None:
            return compare(recording, run_process(package, name, recording, target, Path(folder)))
        image = build(package, name, recording.header, target, level, Path(folder), stack_bytes)
        run = emulate(image, recording.description, len(recording.x))
    return compare(recording, run)


def compare(recording: Recording, run: Outcome) -> Verdict:
    """Compare a run with the recording."""
    tolerance = TOLERANCE[recording.description.precision]
    with np.errstate(invalid="ignore"):
        errors = np.abs(run.u.astype(np.float64) - recording.u) / recording.u_range
    largest = errors.max(axis=1, initial=0.0)
    other = run.status != recording.status
    wrong = np.flatnonzero(other | ~(largest <= tolerance))
    return Verdict(
        run=run,
        samples=len(recording.x),
        tolerance=tolerance,
        error=float(largest.max(initial=0.0)),
        mismatches=tuple(int(k) for k in wrong),
        statuses=int(np.sum(other)),
        example=_example(recording, run, int(wrong[0]), errors) if wrong.size else "",
        bits=int(np.sum(np.any(run.u.astype(np.float64) != recording.u, axis=1))),
    )


def _example(recording: Recording, run: Outcome, k: int, errors: Array) -> str:
    """Describe sample k: its status if that differs, else the control that differs most."""
    if run.status[k] != recording.status[k]:
        return f"sample {k}: status {int(run.status[k])} instead of {int(recording.status[k])}"
    j = int(np.argmax(np.nan_to_num(errors[k], nan=np.inf)))
    name = recording.description.outputs[j]
    return f"sample {k}: {name} {float(run.u[k, j])!r} instead of {float(recording.u[k, j])!r}"
