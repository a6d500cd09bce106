"""nmpc-export checks a package for its target, and adds files for a microcontroller, before anything is written.

certificate.json, certificate.md    properties of the package on the target, for programs and for people
certificate_<name>.json, .md        the same of an estimator beside it
firmware/                           a bare-metal program that replays a recorded closed loop, and its Makefile
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from nmpc_codegen.analysis import worst_case
from nmpc_codegen.errors import OptionError
from nmpc_codegen.firmware.budgets import Budgets, check
from nmpc_codegen.firmware.certificate import REAL_TIME, Certificate, Form, certify, forms_of
from nmpc_codegen.firmware.image import sources
from nmpc_codegen.firmware.layouts import layouts
from nmpc_codegen.firmware.recording import Recording, record, record_estimates, restart_loop
from nmpc_codegen.firmware.toolchain import Level
from nmpc_codegen.firmware.verify import Verdict, verify
from nmpc_codegen.lowering.templates import environment
from nmpc_codegen.options import GOALS
from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.package.deviations import DEVIATIONS
from nmpc_codegen.package.seal import without_seal
from nmpc_codegen.runtime.build import load, load_estimator
from nmpc_codegen.targets import PORTABLE, TARGETS, Target

FOLDER = "firmware"
SAMPLES = 200
NOT_RUN = "Not run: export with --verify."
NOT_FLOWN = "Not flown: export with --campaign."


@dataclass(frozen=True)
class CampaignWords:
    """A campaign that the package has flown, described for programs and for people."""

    entries: Mapping[str, object]
    sentences: str


#: A function that generates the package with other options.
Variant = Callable[..., Mapping[str, str]]


@dataclass(frozen=True)
class Delivery:
    """A delivery consists of the added files and their findings: certificate, sizes and verdict of --verify.

    Certificate and ``forms``, the sizes for every goal, exist for microcontrollers.
    """

    files: Mapping[str, str]
    certificate: Certificate | None
    verdict: Verdict | None
    forms: tuple[Form, ...] = ()


def deliver(
    package: Mapping[str, str],
    name: str,
    level: Level,
    budgets: Budgets,
    run: bool,
    variant: Variant,
    flown: CampaignWords | None = None,
    dumps: int = 0,
) -> Delivery:
    """Check the budgets, replay a closed loop on the target on request, and complete a package for a microcontroller.

    A package for a microcontroller is certified and gets the files from which its firmware is built. ``variant``
    generates the package with other options: for every goal, to compare sizes, and in portable C. ``flown`` is a
    campaign of the package for the certificate; ``dumps`` is the size in bytes of a ring of samples.

    Raises:
        OptionError: a budget is exceeded, or the package cannot be verified.
        BuildError: a tool is missing or refuses the code.
    """
    description = PackageDescription.from_json(package[f"{name}.json"])
    target = TARGETS[description.target]
    if description.dims.nu == 0 and (run or target.board):
        raise OptionError(f"--target: {name} has no controls, so there is nothing to verify")
    if any("/" in path for path in package) and (run or target.board):
        raise OptionError("--target: the package contains foreign code, which is not certified; choose another qp")

    def worst() -> int:
        """Return the worst case of a sample, in portable C if the target computes several nodes at once."""
        return worst_case(package if target.lanes == 1 else variant(target=PORTABLE.name))["sample"]

    if target.board is None:
        check(budgets, description, None, worst, dumps)
        return Delivery({}, None, _verify(package, name, target, variant) if run else None)
    certificate = certify(package, name, target, level)
    check(budgets, description, certificate, worst, dumps)
    recording = record_loop(package, name)
    verdict = verify(package, name, recording, target, level, certificate.stack_worst) if run else None
    files = {
        f"{FOLDER}/{path}": text for path, text in sources(target, recording.header, certificate.stack_worst).items()
    }
    files |= layouts(package, recording, target, certificate, budgets.ram)
    files |= _at_level(package, level)
    forms = forms_of({goal: variant(goal=goal) for goal in GOALS}, name, target)
    files["certificate.json"] = certificate_json(certificate, verdict, forms, flown)
    files["certificate.md"] = page(certificate, verdict, forms, sorted(files), flown)
    return Delivery(files, certificate, verdict, forms)


def deliver_estimator(package: Mapping[str, str], name: str, level: Level, run: bool) -> Delivery:
    """Certify the estimator beside a controller for a microcontroller, and replay it on request.

    Raises:
        BuildError: a tool is missing or refuses the code.
    """
    target = TARGETS[PackageDescription.from_json(package[f"{name}.json"]).target]
    if target.board is None:
        return Delivery({}, None, None)
    certificate = certify(package, name, target, level)
    recording = record_estimates(load_estimator(package, name, "verify"), SAMPLES)
    verdict = verify(package, name, recording, target, level, certificate.stack_worst) if run else None
    paths = [f"certificate_{name}.{ending}" for ending in ("json", "md")]
    texts = certificate_json(certificate, verdict), page(certificate, verdict, files=paths)
    return Delivery(dict(zip(paths, texts, strict=True)), certificate, verdict)


def _at_level(package: Mapping[str, str], level: Level) -> dict[str, str]:
    """Return the files that name an optimisation level, with the level of the certificate and without seals."""
    paths = () if level == "O2" else ("CMakeLists.txt", "README.md")
    return {path: without_seal(package[path]).replace(" -O2 ", f" -{level} ") for path in paths}


def _verify(package: Mapping[str, str], name: str, target: Target, variant: Variant) -> Verdict:
    """Compare the target with portable C on this machine."""
    return verify(package, name, record_loop(variant(target=PORTABLE.name), name), target)


def record_loop(package: Mapping[str, str], name: str) -> Recording:
    """Record the closed loop for the replay: from the declared initial state, then repeatedly from near it."""
    controller = load(package, name, "verify")
    x0 = controller.description.x_initial
    return record(controller, x0, SAMPLES, disturbed=restart_loop(x0))


def certificate_json(
    certificate: Certificate, verdict: Verdict | None, forms: tuple[Form, ...] = (), flown: CampaignWords | None = None
) -> str:
    """Return the certificate as JSON, with the sizes for every goal.

    It includes the results of the emulated run and of the campaign if there are any.
    """
    entries = certificate.as_dict() | {"forms": [form.as_dict() for form in forms]}
    if verdict is not None:
        entries["emulated"] = verdict.as_dict()
    if flown is not None:
        entries["campaign"] = flown.entries
    return json.dumps(entries, indent=1, allow_nan=False) + "\n"


def page(
    certificate: Certificate,
    verdict: Verdict | None,
    forms: tuple[Form, ...] = (),
    files: Sequence[str] = (),
    flown: CampaignWords | None = None,
) -> str:
    """Return the certificate as a page for people; ``files`` lists the files delivered with it."""
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
        "campaign": NOT_FLOWN if flown is None else flown.sentences,
        "verdict": NOT_RUN if verdict is None else sentences(verdict),
    }
    return environment().get_template("firmware/certificate.md.jinja").render(names)


def sentences(verdict: Verdict) -> str:
    """Return sentences on the emulated run."""
    against, criterion = verdict.run.against, f"equal status, controls within {verdict.tolerance:g} of their range"
    largest = f"the largest difference is {verdict.error:.1e} of a range"
    if verdict.passed:
        bits = f"{verdict.bits} samples are not equal to the bit"
        agree = f"All {verdict.samples} samples agree with {against}: {criterion}; {largest}, {bits}."
    else:
        agree = (
            f"{len(verdict.mismatches)} of {verdict.samples} samples differ from {against}, {verdict.statuses} of them "
            f"in their status; expected: {criterion}; {largest}. The first is {verdict.example}."
        )
    return f"{agree}\n\n{verdict.run.sentence}".rstrip()
