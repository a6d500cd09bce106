"""Fixtures shared by all tests: a small package, and tools that may be missing on a machine."""

from __future__ import annotations

import gc
import os
import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

# The matrices of the tests are small: further threads of NumPy's BLAS would only spin, at the expense of other workers.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Otherwise every Python program that a test starts compiles the modules of the project again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import pytest
from hypothesis import settings
from sampling import thin

from nmpc_codegen import compiler as stages
from nmpc_codegen.errors import BuildError, ExtraError
from nmpc_codegen.runtime.batch.cuda import Cuda
from nmpc_codegen.runtime.build import load
from nmpc_codegen.runtime.compilers import find_compiler
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.native import runs
from nmpc_codegen.targets import TARGETS
from tests.cli.cart import write_problem
from tests.units import kept_run, sweep
from verification.problems import toy_sources

# Expressions and texts live as long as the session: a search for garbage after every 700 new objects finds nothing.
gc.set_threshold(100_000)

# The same examples are used in every run, because a suite that fails only occasionally is not informative. Use
# --hypothesis-profile=random to draw others.
settings.register_profile("repeatable", derandomize=True)
settings.register_profile("random", derandomize=False)
settings.load_profile("repeatable")


Files = dict[str, str]

#: Folders and files whose tests run what another compiler than gcc compiles, the more specific ones first; tcc, which
#: knows no vectors, takes half the time.
OTHER_COMPILERS = {
    "clang": frozenset({"test_recovery.py", "test_closed_loop.py"}),
    "tcc": frozenset(
        {
            *("components", "derivatives", "economic", "oracle"),
            *("test_adjoint_shooting.py", "test_augmented_lagrangian.py", "test_decoupled_parts.py"),
            *("test_globalization.py", "test_initial_values.py"),
            *("test_online.py", "test_solve.py", "test_start_cost.py"),
            *("test_linearize.py", "test_unit_names.py"),
            *("test_controller.py", "test_diagnosis.py", "test_given.py", "test_pathrows.py", "test_simulate.py"),
            *("test_status.py", "test_robustness.py"),
        }
    ),
}
#: Files with tests of half a minute.
LONG = frozenset({"test_topics.py", "test_docs.py", "test_papers.py", "test_workers.py", "test_coach.py"})
#: Header files for tcc, by C_INCLUDE_PATH.
TCC_HEADERS = Path(__file__).with_name("tcc")

#: Key of NMPC_REQUIRE -> programs, any of which is sufficient.
TOOLS = {
    "cc": ("gcc", "cc", "clang"),
    "cxx": ("g++", "c++", "clang++"),
    "clang": ("clang",),
    "tcc": ("tcc",),
    "tidy": ("clang-tidy",),
    "cppcheck": ("cppcheck",),
    "cmake": ("cmake",),
    "unifdef": ("unifdef",),
    "arm": ("arm-none-eabi-gcc",),
    "aarch64": ("aarch64-linux-gnu-gcc",),
    "qemu-aarch64": ("qemu-aarch64",),
    "qemu-x86_64": ("qemu-x86_64",),
    "riscv": ("riscv64-unknown-elf-gcc",),
    "qemu-riscv32": ("qemu-system-riscv32",),
    "make": ("make",),
    "qemu": ("qemu-system-arm",),
    "valgrind": ("valgrind",),
    "chromium": ("chromium", "google-chrome"),
}


def require_tool(name: str) -> str:
    """Path of a tool of TOOLS, or of a program; without it the test is skipped.

    NMPC_REQUIRE, a list of names separated by commas, lists the tools that must exist (in CI those that it installs):
    the test then fails instead.
    """
    for program in TOOLS.get(name, (name,)):
        path = shutil.which(program)
        if path is not None:
            return path
    word = name if name in TOOLS else next((word for word, programs in TOOLS.items() if name in programs), name)
    missing(f"there is no program {' or '.join(TOOLS.get(name, (name,)))} on the path", word)
    raise AssertionError("missing() returned")


def missing(reason: str, tool: str) -> None:
    """Skip if a tool (a key of TOOLS) is missing; fail if NMPC_REQUIRE lists it."""
    if tool in {word.strip() for word in os.environ.get("NMPC_REQUIRE", "").split(",")}:
        pytest.fail(f"NMPC_REQUIRE lists {tool!r}, but {reason}")
    pytest.skip(reason)


def require_target(name: str) -> None:
    """Skip the test if this machine does not run the target."""
    require_tool("cc")
    if not runs(TARGETS[name]):
        pytest.skip(f"this machine does not run {name}")


@pytest.fixture(scope="session")
def need() -> Callable[[str], str]:
    """need("cxx") -> its path, or the test is skipped."""
    return require_tool


@pytest.fixture(autouse=True)
def _there_is_a_gpu(request: pytest.FixtureRequest) -> None:
    """A test marked gpu is skipped where CuPy finds none."""
    if request.node.get_closest_marker("gpu") is None:
        return
    try:
        Cuda()
    except (BuildError, ExtraError) as error:
        missing(str(error), "gpu")


@pytest.fixture(scope="session")
def compiler() -> tuple[str, ...]:
    """The C compiler that build() uses, or the test is skipped."""
    try:
        return find_compiler()
    except BuildError as error:
        missing(str(error), "cc")
        raise


@pytest.fixture(scope="module", autouse=True)
def _all_compilers_run(request: pytest.FixtureRequest) -> Iterator[None]:
    """The C that a test runs is that of its compiler in OTHER_COMPILERS if there is such a program, else gcc's."""
    mine = (name for name, tests in OTHER_COMPILERS.items() if tests.intersection(request.path.parts))
    with pytest.MonkeyPatch.context() as patch:
        name = next(mine, None)
        if name is not None and "CC" not in os.environ and shutil.which(name):
            patch.setenv("CC", name)
            if name == "tcc":
                patch.setenv("C_INCLUDE_PATH", str(TCC_HEADERS))
        yield


@pytest.fixture
def state_problem(tmp_path: Path) -> Callable[[str], str]:
    """state_problem("ocp = cart()") -> path of a problem file for the command line."""
    return partial(write_problem, tmp_path)


@pytest.fixture(scope="session")
def toy_files() -> Files:
    """Texts of a small package."""
    return dict(toy_sources())


@pytest.fixture(scope="session")
def toy_single_files() -> Files:
    """The same in single precision."""
    return dict(toy_sources("single"))


@pytest.fixture(scope="session")
def _toy(toy_files: Files, compiler: tuple[str, ...]) -> Controller:
    return load(toy_files, "toy", "test")


@pytest.fixture
def toy(_toy: Controller) -> Controller:
    """A fresh toy controller."""
    return _toy.copy()


def pytest_configure(config: pytest.Config) -> None:
    """Units are pruned once for the same items. A warning about a problem fails the test; in pyproject.toml it would
    load NumPy before this file is read."""
    stages.run = kept_run
    if not hasattr(config, "workerinput"):
        sweep()
    config.addinivalue_line("filterwarnings", "error::nmpc_codegen.errors.ProblemWarning")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Before "slow" is deselected: the combinations that `make test` leaves out get that marker.

    Long files come first, so that no worker waits for another at the end.
    """
    thin(items)
    items.sort(key=lambda item: (item.path.name not in LONG, "whole" not in item.path.parts))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Assign a file to one worker, so that the builds of a test module happen once, not once per worker; of contracts a
    sample."""
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return nodeid.partition("-" if "under_contract" in nodeid else "::")[0]

    config.option.loadscopereorder = False  # files come in the order of the items
    return Scheduling(config, log)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options that rewrite a file instead of comparing with it."""
    parser.addoption("--update-golden", action="store_true", help="write tests/golden/header.h anew")
    parser.addoption("--update-baseline", action="store_true", help="write tests/data/baseline.json anew")
