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
    _, highest, most = fitting(ocp, options, 10**12)
    least = fitting(ocp, options, most - 1)[2]
    assert least < most == worst(options)
    limit = (least + most) // 2
    found, cap, stated = fitting(ocp, options, limit)
    assert stated == worst(found) <= limit
    assert 1 <= cap < highest
    again, same, _ = fitting(ocp, found, stated)
    assert (again, worst(again)) == (found, stated)
    assert same <= cap
    following = fitting(ocp, options, limit + 1)[1]
    assert following >= cap


def test_caps_that_fit_are_kept() -> None:
    options = Options(qp=DenseActiveSet(max_iterations=3))
    assert fitting(crane.build_ocp(False), options, 10**12)[0] is options


def test_other_options_are_kept() -> None:
    options = Options(algorithm=RealTimeIteration(shift="repeat", tolerance=0.2), precision="single")
    found = fitting(crane.build_ocp(False), options, worst(options) // 2)[0]
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
    assert fitting(ocp, apply_settings(options, offered), limit)[2] <= limit


def test_a_limit_below_everything() -> None:
    with pytest.raises(OptionError, match=r"--max-operations 10: crane takes .* with --set .*; try fewer intervals"):
        fitting(crane.build_ocp(False), Options(), 10)


def test_what_is_not_known() -> None:
    with pytest.raises(OptionError, match="the worst case of a sample is unknown"):
        fitting(crane.build_ocp(False), Options(qp=Osqp()), 10**9)


def test_the_command_line_exports_what_fits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    problem = tmp_path / "problem.py"
    problem.write_text("from examples.crane import build_ocp\nocp = build_ocp(False)\n", encoding="utf-8")
    limit = worst(Options()) // 3
    folder = tmp_path / "out"
    assert main([str(problem), "-o", str(folder), "--max-operations", str(limit), "-v"]) == 0
    out = capsys.readouterr().out
    stated = re.search(r"which takes ([\d,]+) operations at most", out)
    assert stated is not None
    assert f"sample {stated[1]} operations" in out
    assert int(stated[1].replace(",", "")) <= limit
    assert main([str(problem), "-o", str(tmp_path / "none"), "--max-operations", "10"]) == 1
    assert not (tmp_path / "none").exists()
