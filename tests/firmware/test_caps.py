"""firmware/caps.py: the largest caps on iterations that a limit on operations allows."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest

from examples import crane
from nmpc_codegen import (
    AdjointShooting,
    AugmentedLagrangian,
    DenseActiveSet,
    OptionError,
    Options,
    Osqp,
    RealTimeIteration,
    RiccatiActiveSet,
    RiccatiInteriorPoint,
    generate,
    worst_case,
)
from nmpc_codegen.cli import main
from nmpc_codegen.cli.settings import apply_settings
from nmpc_codegen.firmware.caps import fitting

CASES = {
    "dense": Options(qp=DenseActiveSet()),
    "riccati": Options(qp=RiccatiActiveSet()),
    "alone": Options(qp=RiccatiActiveSet(fallback=None)),
    "interior": Options(qp=RiccatiInteriorPoint()),
    "chosen": Options(),
    "augmented": Options(algorithm=AugmentedLagrangian(iterations=8)),
    "shooting": Options(algorithm=AdjointShooting()),
    "quasi-Newton": Options(algorithm=AdjointShooting(method="quasi_newton", iterations=8)),
}


def worst(options: Options) -> int:
    return worst_case(generate(crane.build_ocp(False), options))["sample"]


@pytest.mark.few(5)
@pytest.mark.parametrize("case", CASES)
def test_the_caps_are_the_largest_that_fit(case: str) -> None:
    ocp, options = crane.build_ocp(False), CASES[case]
    whole = fitting(ocp, options, 10**12)
    next_ = fitting(ocp, options, whole.worst - 1)
    assert next_.worst < whole.worst == worst(options)
    limit = (next_.worst + whole.worst) // 2
    fit = fitting(ocp, options, limit)
    assert fit.worst == worst(fit.options) <= limit
    assert 1 <= fit.most < whole.most
    assert fitting(ocp, fit.options, fit.worst).options is fit.options


def test_caps_that_fit_are_kept() -> None:
    options = Options(qp=DenseActiveSet(max_iterations=3))
    assert fitting(crane.build_ocp(False), options, 10**12).options is options


def test_other_options_are_kept() -> None:
    options = Options(algorithm=RealTimeIteration(shift="repeat", tolerance=0.2), precision="single")
    found = fitting(crane.build_ocp(False), options, worst(options) // 2).options
    assert found.algorithm == options.algorithm
    assert dataclasses.replace(found, qp=None, condensing=None) == options


def test_the_advice_helps() -> None:
    """What the message offers is taken by the command line, and fits."""
    ocp, options = crane.build_ocp(False), Options(qp=RiccatiActiveSet())
    plain = Options(qp=RiccatiActiveSet(fallback=None), algorithm=RealTimeIteration(repair=0, relaxation=None))
    limit = worst(dataclasses.replace(plain, qp=RiccatiActiveSet(fallback=None, max_iterations=1)))
    with pytest.raises(OptionError, match=rf"--max-operations {limit}: crane takes [\d,]+ operations .* try ") as error:
        fitting(ocp, options, limit)
    offered = re.findall(r"--set (\S+)=(\S+)", str(error.value))
    assert fitting(ocp, apply_settings(options, offered), limit).worst <= limit


def test_a_limit_below_everything() -> None:
    with pytest.raises(OptionError, match=r"--max-operations 10: crane takes .* with --set .*; try fewer intervals"):
        fitting(crane.build_ocp(False), Options(), 10)


def test_low_caps_are_warned_of() -> None:
    ocp, options = crane.build_ocp(False), Options(qp=DenseActiveSet())
    whole = fitting(ocp, options, 10**12)
    near, far = (fitting(ocp, options, int(share * whole.worst)) for share in (0.9, 0.3))
    assert near.warning == ""
    assert near.most < whole.most
    assert f"caps of {far.most} instead of {whole.most}" in far.warning
    assert "--set algorithm.repair=0 allows larger ones" in far.warning


def test_what_is_not_known() -> None:
    with pytest.raises(OptionError, match=r"--max-operations 1000000000: other contains foreign code"):
        fitting(crane.build_ocp(False), Options(qp=Osqp()), 10**9, "other")


def test_the_command_line_exports_what_fits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    problem = tmp_path / "problem.py"
    problem.write_text("from examples.crane import build_ocp\nocp = build_ocp(False)\n", encoding="utf-8")
    limit = worst(Options()) // 3
    folder = tmp_path / "out"
    assert main([str(problem), "-o", str(folder), "--max-operations", str(limit), "-v"]) == 0
    out = capsys.readouterr().out
    stated = re.search(r"caps +at most \d+ iterations: a sample takes ([\d,]+) operations at most", out)
    assert stated is not None
    assert f"sample {stated[1]} operations" in out
    assert "fewest operations of a warm-started sample" in out
    assert "may end samples with ITERATION_LIMIT" in out
    assert int(stated[1].replace(",", "")) <= limit
    assert main([str(problem), "-o", str(tmp_path / "none"), "--max-operations", "10"]) == 1
    assert not (tmp_path / "none").exists()


def test_caps_of_a_target_with_lanes_are_those_of_portable_c() -> None:
    ocp = crane.build_ocp(False)
    limit = worst(Options()) // 3
    wide, portable = (fitting(ocp, Options(target=target), limit) for target in ("x86-64-v3", "portable"))
    assert (wide.most, wide.worst) == (portable.most, portable.worst)
    assert wide.options.target == "x86-64-v3"
    with pytest.raises(OptionError, match=r"crane is written in GNU C for x86-64-v3.*target=\"portable\""):
        worst_case(generate(ocp, Options(target="x86-64-v3")))


def test_what_a_package_lacks_is_not_given_up() -> None:
    """A package for a microcontroller has no repair: neither warning nor refusal name it."""
    ocp, options = crane.build_ocp(False), Options(qp=DenseActiveSet(), target="cortex-m4f")
    low = fitting(ocp, options, worst(options) // 2)
    assert low.warning
    assert "repair" not in low.warning
    with pytest.raises(OptionError, match=r"with --set algorithm\.relaxation=None; try fewer"):
        fitting(ocp, options, 10)
