"""Reference loops show what flights would have cost with a converged plan in every sample."""

from __future__ import annotations

from contextlib import suppress
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.campaigns.flying.fly import Flyer, Job
from nmpc_codegen.economic.stage import tableau
from nmpc_codegen.errors import ControllerError, OptionError
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.completion.complete import complete
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.options import Options
from nmpc_codegen.oracle.reference import Reference, node_data
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.diagnosis.plan_rows import parameters
from nmpc_codegen.runtime.loops.flown import Flown
from nmpc_codegen.runtime.loops.one_loop import Conduct, Sample

Array = NDArray[np.float64]
Against = Literal["solve", "ipopt"]

TOLERANCE = 1e-8  # tolerance of IPOPT


def reference_costs(job: Job, flown: Flown, against: Against, count: int, ocp: OCP, options: Options) -> Array:
    """Return the costs (F,) of loops with converged plans for the first ``count`` flights.

    Other flights, flights whose state was not finite, and those after an interrupt have NaN. ``against`` is "solve",
    with solve() in every sample, or "ipopt", which starts from the plan of the previous sample.
    """
    found = np.full(len(flown), np.nan)
    flyer, s = Flyer(job, None), job.statement
    law = _IpoptLaw(job.controller, ocp, options) if against == "ipopt" else None
    with suppress(KeyboardInterrupt):
        for i, number in enumerate(int(n) for n in flown.number[:count]):
            if flown.broken[i] < 0:
                data = s.whole_data(number)
                with suppress(ControllerError):  # the state of the plant is not finite
                    ctrl = job.controller.copy()
                    log = job.fly_again(ctrl, number, Conduct(law="solve" if law is None else law.begin(ctrl)))
                    found[i] = flyer.judge(data, number, (log.x[None], log.u[None], log.z[None]))[0]
    return found


def check_against(controller: Controller, against: Against | None, options: Options) -> None:
    """Raise OptionError if the package has no solve(), or IPOPT's loop cannot handle the problem."""
    if against == "solve" and not options.solves:
        raise OptionError("against='solve': the package has no solve(); Options(solve=True), or against='ipopt'")
    if against == "ipopt" and (controller.description.augmentation.count or controller.description.discrete):
        raise OptionError("against='ipopt': the problem has time, previous controls or a map; against='solve' serves")


class _IpoptLaw:
    """A control law that solves every sample by IPOPT."""

    def __init__(self, controller: Controller, ocp: OCP, options: Options) -> None:
        self._problem = complete(classify(ocp, options.algorithm.sampling_time), options)
        self._nlp = Reference(self._problem, tableau(self._problem, options), tol=TOLERANCE)

    def begin(self, controller: Controller) -> Sample:
        """Return the function that takes the samples of a flight, with the data of its controller."""
        plan: list[Array | None] = [None, None]

        def sample(x: Array, k: int) -> tuple[Array, int]:
            data = node_data(self._problem, x0=x, **_data_of(controller))
            found = self._nlp.solve(data, x=plan[0], u=plan[1])
            plan[:] = np.vstack([found.x[1:], found.x[-1:]]), np.vstack([found.u[1:], found.u[-1:]])
            return found.u[0], 0

        return sample


def _data_of(controller: Controller) -> dict[str, Any]:
    """Return the parameters and references of a controller, as node_data() takes them."""
    d, found = controller.dims, dict[str, Any]({"p": parameters(controller)} if controller.dims.np else {})
    if controller.description.online["reference"] != "fixed":
        found |= {"yref": np.broadcast_to(np.asarray(controller.view("yref"), float), (d.N, d.ny))} if d.ny else {}
        found |= {"yref_N": np.asarray(controller.view("yref_N"), float).ravel()} if d.ny_N else {}
    return found
