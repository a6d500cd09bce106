"""Controllers of many problems are compiled side by side."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor

from nmpc_codegen import OCP, Controller, Options, generate
from nmpc_codegen.runtime.build import load


def build_all(wanted: Iterable[tuple[OCP, Options]], profile: str = "fast") -> list[Controller]:
    """Generate packages one after the other, and compile two at a time.

    CasADi counts references to its objects without locks, so that all its calls stay in this thread.
    """
    found: list[Future[Controller]] = []
    with ThreadPoolExecutor(2) as pool:
        for ocp, options in wanted:
            found.append(pool.submit(load, generate(ocp, options), ocp.name, profile))
    return [future.result() for future in found]
