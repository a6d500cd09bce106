"""Two campaigns are the same if the digests of all data that determine their flights are equal."""

from __future__ import annotations

import hashlib
from typing import Any

import msgspec
import numpy as np

from nmpc_codegen.campaigns.flying.fly import Job
from nmpc_codegen.runtime.batch.random import DISTURBANCE, NOISE, signal


def digest(value: Any) -> str:
    """Return the SHA-256 of numbers, strings, arrays, and mappings and dataclasses of them."""
    return hashlib.sha256(msgspec.msgpack.encode(value, enc_hook=_plain, order="deterministic")).hexdigest()


def _plain(value: Any) -> Any:
    """Convert a value for the digest: arrays to type, shape and bytes, NumPy scalars to Python's, others to repr()."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    return value.item() if isinstance(value, np.generic) else repr(value)


def identity(job: Job) -> dict[str, Any]:
    """Return the data that determine the flights of a job, as words and digests.

    The number of flights is included only if the flights depend on it.
    """
    s, controller = job.statement, job.controller
    independent = not s.points.sets and not s.given.starts and not s.given.tables and s.given.added is None
    packages = [
        (c._package.fingerprint, c._package.profile, c._memory.tobytes())
        for c in (controller, job.plant)
        if c is not None
    ]
    return {
        "controller": controller.description.name,
        "package": digest(packages[0]),
        "plant": digest(packages[1:]),
        "steps": s.steps,
        "dt": s.dt,
        "seed": s.seed,
        "flights": None if independent else s.flights,
        "starts": digest([s.x0, [v for v in s.variables if v.kind == "start"], s.given.starts]),
        "data": digest([[v for v in s.variables if v.kind != "start"], s.tables, s.given.tables]),
        "points": digest([s.points.sets, s.points.length]),
        "disturbance": digest([signal(s.disturbance, "disturbance", s.states, DISTURBANCE), s.added, s.given.added]),
        "noise": digest(signal(s.noise, "noise", s.states, NOISE)),
        "device": job.device,
    }
