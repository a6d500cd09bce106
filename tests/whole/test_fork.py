"""A process that is forked while another thread builds a controller, stated before the fork, can build one itself."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import faulthandler, os, sys, threading, time
from nmpc_codegen import OCP, build
import casadi as ca

def ocp(N):
    ocp = OCP("forked", T=1.0, N=N)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: ca.sin(x) + u})
    ocp.least_squares(ca.vertcat(x, u), weight=1)
    return ocp

thread = threading.Thread(target=build, args=(ocp(30),), kwargs={"profile": "test"})
thread.start()
time.sleep(float(sys.argv[1]))
child = os.fork()
if child == 0:
    faulthandler.dump_traceback_later(50, exit=True)
    build(ocp(3), profile="test")
    os._exit(7)
_, status = os.waitpid(child, 0)
thread.join()
sys.exit(0 if os.waitstatus_to_exitcode(status) == 7 else 1)
"""


@pytest.mark.few(1)
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.parametrize("delay", [0.0, 0.02, 0.1, 0.3])
def test_build_in_a_child(delay: float, tmp_path: Path, compiler: tuple[str, ...]) -> None:
    """At any time: while modules are loaded, the first temporary folder is made, CasADi works, the compiler runs."""
    environment = {**os.environ, "NMPC_CODEGEN_CACHE": str(tmp_path)}
    command = [sys.executable, "-c", PROGRAM, str(delay)]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=120)
    assert run.returncode == 0, run.stderr
