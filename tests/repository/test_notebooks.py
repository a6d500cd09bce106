"""The notebooks of docs/: they run as they are, and hold what they show."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from tests.repository.test_architecture import ROOT

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")

NOTEBOOKS = sorted((ROOT / "docs").glob("*.ipynb"))
LARGEST = 500_000  # bytes


def execute(notebook: Any, folder: Path) -> Any:
    """The notebook after a run in that folder, by this Python, with kernels of its own."""
    kernel = {"argv": [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"], "display_name": "Python"}
    from jupyter_client.kernelspec import KernelSpec
    from jupyter_client.manager import AsyncKernelManager

    manager = AsyncKernelManager(transport="ipc", connection_file=str(folder / "kernel.json"))
    manager._kernel_spec = KernelSpec(language="python", **kernel)
    client = nbclient.NotebookClient(notebook, km=manager, timeout=240, resources={"metadata": {"path": str(folder)}})
    return client.execute()


def shown(cell: Any) -> list[str]:
    """The richest kind of everything that a cell shows."""
    kinds = ("image/png", "text/html", "text/plain")
    return [next(kind for kind in kinds if kind in output.get("data", {"text/plain": ""})) for output in cell.outputs]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, tmp_path: Path) -> None:
    """Every cell runs, and shows as many pictures and tables as it holds."""
    stored = nbformat.read(path, 4)
    again = execute(nbformat.read(path, 4), tmp_path)
    for before, after in zip(stored.cells, again.cells, strict=True):
        if before.cell_type == "code":
            assert before.execution_count, before.source
            assert shown(before) == shown(after), before.source
    assert sum("image/png" in kind for cell in stored.cells if cell.cell_type == "code" for kind in shown(cell)) >= 4
    assert path.stat().st_size <= LARGEST
    assert str(Path.home()) not in path.read_text(encoding="utf-8")


def test_a_picture_is_shown_once_and_the_display_stays_interactive(tmp_path: Path) -> None:
    """In a kernel without %matplotlib inline: by the first call, as a value, by name, in a later cell; a film plays."""
    cells = {
        "import casadi as ca\nfrom nmpc_codegen import OCP, Options, build, simulate\nocp = OCP('cart', T=1.0, N=3)\n"
        "x, u = ocp.state('x'), ocp.control('u')\nocp.dynamics({x: u})\nocp.least_squares(ca.vertcat(x, u), 1.0)\n"
        "log = simulate(build(ocp, profile='test'), [1.0], 5)": [],
        "log.plot()": ["image/png"],
        "figure = log.plot()": ["image/png"],
        "figure": ["image/png"],
        "log.plot_plans(); 3": ["image/png", "text/plain"],
        "log.plot('loop.png')": ["image/png"],
        "import matplotlib; matplotlib.is_interactive()": ["text/plain"],
        "Options()": ["text/html"],
        "log": ["text/html"],
        "log.animate()": ["text/html"],
    }
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(source) for source in cells])
    found = execute(notebook, tmp_path).cells
    assert {cell.source: sorted(shown(cell)) for cell in found} == cells
    assert found[6].outputs[0].data["text/plain"] == "True"
