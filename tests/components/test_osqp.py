"""OSQP as a component of the built controller, against the dense active-set solver; foreign code and export()."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nmpc_codegen import OptionError, Options, Osqp, build, export, generate, open_package
from nmpc_codegen.package.status import Status
from verification import problems
from verification.routes import PURE

OPTIONS = Options(qp=Osqp(), algorithm=PURE)


def test_copies_share_the_workspace_and_answer_alike() -> None:
    """Interleaved calls of two copies at different states: each gives the same result as alone."""
    case = problems.CASES["crane"]
    first = build(case.make(), OPTIONS, profile="test", name="crane_osqp")
    second, alone = first.copy(), problems.controller("crane")
    far = np.array(case.x0) * 0.5
    first.prepare()
    second.prepare()
    u_first, u_second = first.feedback(case.x0), second.feedback(far)
    np.testing.assert_allclose(u_first, alone.step(case.x0), atol=1e-5)
    alone.reset()
    np.testing.assert_allclose(u_second, alone.step(far), atol=1e-5)


def test_infeasible_is_told() -> None:
    controller = build(problems.CASES["crane"].make(), OPTIONS, profile="test", name="crane_osqp")
    controller.step([50.0, 0.0, 0.0, 0.0])
    assert controller.status == Status.INFEASIBLE
    certificate = controller.view("qp")["certificate"]
    assert np.max(np.abs(certificate)) == 1.0


def test_export_needs_consent(tmp_path: Path) -> None:
    ocp = problems.CASES["crane"].make()
    with pytest.raises(OptionError, match="foreign"):
        export(ocp, OPTIONS, tmp_path / "refused")
    assert not (tmp_path / "refused").exists()
    package = export(ocp, OPTIONS, tmp_path / "allowed", allow_foreign=True)
    assert any("osqp" in path.parts for path in package.files)
    controller = open_package(tmp_path / "allowed", profile="test")
    assert np.isfinite(controller.step(problems.CASES["crane"].x0)).all()
    assert controller.status == Status.OK


def test_the_text_is_deterministic() -> None:
    ocp = problems.CASES["crane"].make()
    assert generate(ocp, OPTIONS) == generate(ocp, OPTIONS)


@pytest.mark.parametrize(
    ("bad", "message"),
    [({"max_iterations": 0}, "max_iterations"), ({"eps": -1.0}, "eps"), ({"eps": True}, "eps")],
)
def test_options_defend_themselves(bad: dict[str, object], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        Osqp(**bad)  # type: ignore[arg-type]


def test_single_precision_is_refused() -> None:
    with pytest.raises(OptionError, match="precision"):
        generate(problems.CASES["crane"].make(), Options(qp=Osqp(), precision="single"))
