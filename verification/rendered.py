"""The packages of samples are cached before lowering, before rendering, and as text."""

from __future__ import annotations

from functools import cache

from nmpc_codegen.compiler import model_of, read, text_of
from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.lowering.linearize import Model
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.package.sources import Sources
from verification.timed import Sample


@cache
def model(sample: Sample) -> Model:
    """Return the Model of a sample."""
    return model_of(*read(sample.make(), sample.options))


@cache
def lowered(sample: Sample) -> CModule:
    """Return the CModule of a sample, before rendering."""
    return lower(model(sample))


def texts(sample: Sample) -> Sources:
    """Return the package of a sample, without third-party code."""
    return text_of(lowered(sample))
