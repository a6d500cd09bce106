"""What an export for a target adds to a package, before anything is written: budgets, certificate, emulated run, files.

certificate.json, certificate.md    properties of the package on the target, for programs and for people
firmware/                           a bare-metal program that replays a recorded closed loop, and its Makefile
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from nmpc_codegen.errors import OptionError
from nmpc_codegen.firmware.budgets import Budgets, check
from nmpc_codegen.firmware.certificate import REAL_TIME, Certificate, certify
from nmpc_codegen.firmware.deviations import DEVIATIONS
from nmpc_codegen.firmware.forms import Form, forms_of
from nmpc_codegen.firmware.image import sources
from nmpc_codegen.firmware.layouts import layouts
from nmpc_codegen.firmware.recording import Recording, record, started_again
from nmpc_codegen.firmware.targets import ICOUNT_SHIFT, Level, Target
from nmpc_codegen.firmware.verify import Verdict, verify
from nmpc_codegen.lowering.render import environment
from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.runtime.build import load

FOLDER = "firmware"
SAMPLES = 200
NOT_RUN = "Not run: export with --verify."


@dataclass(frozen=True)
class Delivery:
    """The files that are added, and what was found: certificate and verdict, None without a target or --verify.

    ``forms``: sizes for every goal, empty if they have not been asked for.
    """

    files: Mapping[str, str]
    certificate: Certificate | None
    verdict: Verdict | None
    forms: tuple[Form, ...] = ()


def deliver(
    package: Mapping[str, str],
    name: str,
    target: Target | None,
    level: Level,
    budgets: Budgets,
    run: bool,
    goals: Callable[[], Mapping[str, Mapping[str, str]]] = dict,
) -> Delivery:
    """Check the budgets; for a target also certify the package, record a closed loop and, on request, replay it.

    ``goals``: makes the package for every goal, whose sizes are compared.

    Raises:
        OptionError: a budget is exceeded.
        BuildError: a tool is missing or refuses the code.
    """
    description = PackageDescription.from_json(package[f"{name}.json"])
    if target is not None and description.dims.nu == 0:
        raise OptionError(f"--target: {name} has no controls, so there is nothing to verify")
    if target is not None and any("/" in path for path in package):
        raise OptionError("--target: the package contains foreign code, which is not certified; choose another qp")
    certificate = None if target is None else certify(package, name, target, level)
    check(budgets, description, certificate)
    if target is None or certificate is None:
        return Delivery({}, None, None)
    recording = recorded(package, name)
    verdict = verify(package, name, recording, target, level, certificate.stack_worst) if run else None
    files = {
        f"{FOLDER}/{path}": text for path, text in sources(target, recording.header, certificate.stack_worst).items()
    }
    files |= layouts(package, recording, target, certificate, budgets.ram)
    forms = forms_of(goals(), name, target)
    files["certificate.json"] = certificate_json(certificate, verdict, forms)
    files["certificate.md"] = page(certificate, verdict, forms, sorted(files))
    return Delivery(files, certificate, verdict, forms)


def recorded(package: Mapping[str, str], name: str) -> Recording:
    """The closed loop that is replayed: from the declared initial state, and again from near it."""
    controller = load(package, name, "verify")
    x0 = controller.description.x_initial
    return record(controller, x0, SAMPLES, disturbed=started_again(x0))


def certificate_json(certificate: Certificate, verdict: Verdict | None, forms: tuple[Form, ...] = ()) -> str:
    """The certificate, the sizes for every goal, and the outcome of the run if there was one."""
    entries = certificate.as_dict() | {"forms": [form.as_dict() for form in forms]}
    if verdict is not None:
        entries["emulated"] = verdict.as_dict()
    return json.dumps(entries, indent=1, allow_nan=False) + "\n"


def page(
    certificate: Certificate, verdict: Verdict | None, forms: tuple[Form, ...] = (), files: Sequence[str] = ()
) -> str:
    """The certificate for people; ``files``: those that came with it."""
    goals = environment().get_template("firmware/certificate_goals.md.jinja")
    names = {
        "c": certificate,
        "goals": goals.render(forms=forms) if forms else "",
        "real_time": ", ".join(REAL_TIME),
        "math": ", ".join(certificate.math_functions) or "none",
        "compiler": ", ".join(certificate.compiler_functions) or "none",
        "double": ", ".join(certificate.double_functions) or "none",
        "deviations": DEVIATIONS,
        "files": files,
        "verdict": NOT_RUN if verdict is None else sentences(verdict),
    }
    return environment().get_template("firmware/certificate.md.jinja").render(names)


def sentences(verdict: Verdict) -> str:
    """What the emulated run showed."""
    run = verdict.run
    agree = (
        f"All {verdict.samples} samples agree with the host"
        if verdict.passed
        else f"{len(verdict.mismatches)} of {verdict.samples} samples differ, the first is {verdict.mismatches[0]}"
    )
    return (
        f"{agree}: equal status, controls within {verdict.tolerance:g} of their range; the largest difference is "
        f"{verdict.error:.1e}, {verdict.bits} samples are not equal to the bit.\n\n"
        f"Emulated instructions per sample (not cycles; -icount shift={ICOUNT_SHIFT}): median {run.median:,}, "
        f"worst {run.worst:,}. Painted stack of the run: "
        + ", ".join(f"{entry} {used:,}" for entry, used in run.stack.items())
        + " bytes."
    )
