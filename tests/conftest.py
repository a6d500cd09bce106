"""Fixtures shared by all tests: the hand-written toy package, and tools that a machine may lack."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from nmpc_codegen.build import find_compiler, load
from nmpc_codegen.controller import Controller
from nmpc_codegen.errors import BuildError

DATA = Path(__file__).parent / "data"

Files = dict[str, str]


def missing(reason: str) -> None:
    """Skip for want of a tool; where NMPC_REQUIRE is set (CI) fail instead."""
    if os.environ.get("NMPC_REQUIRE"):
        pytest.fail(f"NMPC_REQUIRE is set, but {reason}")
    pytest.skip(reason)


@pytest.fixture(scope="session")
def need() -> Callable[[str], str]:
    """need("g++") -> its path, or the test is skipped."""

    def find(program: str) -> str:
        path = shutil.which(program)
        if path is None:
            missing(f"there is no program {program!r} on the path")
        return str(path)

    return find


@pytest.fixture(scope="session")
def compiler() -> tuple[str, ...]:
    """The C compiler that build() uses, or the test is skipped."""
    try:
        return find_compiler()
    except BuildError as error:
        missing(str(error))
        raise


@pytest.fixture(scope="session")
def toy_files() -> Files:
    """Texts of the hand-written toy package."""
    return {path.name: path.read_text(encoding="utf-8") for path in (DATA / "toy").iterdir()}


@pytest.fixture(scope="session")
def toy_single_files(toy_files: Files) -> Files:
    """The toy package in single precision."""
    return {
        **toy_files,
        "toy.h": toy_files["toy.h"].replace("typedef double toy_real", "typedef float toy_real"),
        "toy.json": toy_files["toy.json"].replace('"precision": "double"', '"precision": "single"'),
    }


@pytest.fixture(scope="session")
def _toy(toy_files: Files, compiler: tuple[str, ...]) -> Controller:
    return load(toy_files, "toy", "test")


@pytest.fixture
def toy(_toy: Controller) -> Controller:
    """A fresh toy controller."""
    return _toy.copy()
