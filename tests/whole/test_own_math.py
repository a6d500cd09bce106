"""math="own": errors of the functions, the same bits in lanes and in closed loops, no libm, what is refused."""

from __future__ import annotations

import ctypes
import math
import random
import re
import subprocess
import warnings
from fractions import Fraction
from pathlib import Path
from types import ModuleType

import casadi as ca
import numpy as np
import pytest
from conftest import require_target, require_tool

from examples import crane, cstr, quadrotor
from nmpc_codegen import OCP, Controller, OptionError, Options, Osqp, ProblemWarning, build, derivatives, generate
from nmpc_codegen.cli.command import main
from nmpc_codegen.lowering.unit.read import own_names
from nmpc_codegen.package.program import OF_TWO
from nmpc_codegen.package.struct_layout import Precision
from nmpc_codegen.runtime.build import PROFILES
from verification import quality
from verification.own_functions import (
    LIMIT,
    SCALAR_ONLY,
    arguments,
    evaluate,
    exact,
    library,
    names,
    pairs,
    special,
    ulps,
)

EXAMPLES: dict[str, ModuleType] = {"crane": crane, "cstr": cstr, "quadrotor": quadrotor}
TYPES = {False: np.float32, True: np.float64}
SAMPLES = 20_000


@pytest.fixture(scope="module", params=[False, True], ids=["single", "double"])
def loaded(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[ctypes.CDLL, bool]:
    require_tool("cc")
    folder = tmp_path_factory.mktemp("functions")
    return library(folder, not request.param, 4, False, PROFILES["verify"].flags), request.param


def drawn(name: str, double: bool, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Arguments, special values among them."""
    generator = np.random.default_rng(seed)
    if name in OF_TWO:
        return pairs(TYPES[double], generator, SAMPLES)
    x = arguments(TYPES[double], generator, SAMPLES)
    return x, x


@pytest.mark.few(40)
@pytest.mark.parametrize("name", names())
def test_functions_are_exact_to_two_units(name: str, loaded: tuple[ctypes.CDLL, bool]) -> None:
    """Also at infinities, NaN, subnormal numbers and the largest arguments."""
    library_, double = loaded
    x, y = drawn(name, double)
    found = ulps(evaluate(library_, f"own_{name}", x, y), exact(name, x, y))
    worst = found.argmax()
    assert found.max() <= LIMIT, (name, x[worst], y[worst])


@pytest.mark.parametrize("name", [name for name in names() if name not in SCALAR_ONLY])
def test_lanes_have_the_same_bits(name: str, loaded: tuple[ctypes.CDLL, bool]) -> None:
    library_, double = loaded
    x, y = drawn(name, double, seed=5)
    one, several = (evaluate(library_, f"{prefix}_{name}", x, y) for prefix in ("own", "lanes"))
    np.testing.assert_array_equal(one, several)
    np.testing.assert_array_equal(np.signbit(one)[~np.isnan(one)], np.signbit(several)[~np.isnan(several)])


@pytest.mark.parametrize("name", sorted({*names()} - {"hypot", "fabs", "cos", "cosh", "acos", "acosh", "log", "exp"}))
def test_zeros_keep_their_sign(name: str, loaded: tuple[ctypes.CDLL, bool]) -> None:
    library_, double = loaded
    a, b = (grid.ravel() for grid in np.meshgrid(special(TYPES[double]), special(TYPES[double])))
    with np.errstate(all="ignore"):
        expected = exact(name, a, b).astype(TYPES[double])
    got = evaluate(library_, f"own_{name}", a, b)
    zeros = (expected == 0) & (got == 0)
    if name in ("fmin", "fmax"):
        zeros &= a != b  # of two zeros either is right
    np.testing.assert_array_equal(np.signbit(got[zeros]), np.signbit(expected[zeros]))


def test_contraction_leaves_the_functions_exact(tmp_path: Path) -> None:
    """Fused products change bits, but must not break what is computed with rests."""
    require_tool("cc")
    fused = library(tmp_path, False, 1, False, (*PROFILES["fast"].flags, "-ffp-contract=fast"))
    for name in names():
        x, y = drawn(name, True, seed=7)
        assert ulps(evaluate(fused, f"own_{name}", x, y), exact(name, x, y)).max() <= LIMIT, name


def arctangent(inverse: int, digits: int) -> int:
    """atan(1 / inverse) 10^digits."""
    total = term = 10**digits // inverse
    n, sign = 1, 1
    while term:
        term //= inverse * inverse
        n, sign = n + 2, -sign
        total += sign * (term // n)
    return total


def test_large_angles_against_integers(loaded: tuple[ctypes.CDLL, bool]) -> None:
    """sin near multiples of pi / 2, from pi to 400 digits: no floating point in the oracle."""
    library_, double = loaded
    digits = 400
    half_pi = Fraction(2 * (4 * arctangent(5, digits + 10) - arctangent(239, digits + 10)), 10 ** (digits + 10))
    generator, dtype = random.Random(1), TYPES[double]
    highest = 1000 if double else 120
    for _ in range(200):
        power = generator.uniform(1, highest)
        x = dtype(math.ldexp(generator.uniform(1, 2), int(power)))
        turns = round(Fraction(float(x)) / half_pi)
        rest = float(Fraction(float(x)) - turns * half_pi)
        value = (math.sin, math.cos)[turns % 2](rest) * (1, 1, -1, -1)[turns % 4]
        got = evaluate(library_, "own_sin", np.full(8, x))[0]
        assert abs(float(got) - value) <= 2 * float(np.spacing(dtype(abs(value)))), float(x)


def test_hardest_angle(tmp_path: Path) -> None:
    """The number in double precision that is closest to a multiple of pi / 2, relative to its size."""
    require_tool("cc")
    built = library(tmp_path, False, 1, False, PROFILES["verify"].flags)
    x = np.array([6381956970095103.0 * 2.0**797])
    assert evaluate(built, "own_cos", x)[0] == pytest.approx(-4.6871659242546277e-19, rel=1e-15)


def closed_loop(controller: Controller, example: ModuleType, samples: int) -> np.ndarray:
    """Controls of a loop whose plant is the model."""
    x, controls = np.array(controller.description.x_initial), []
    sampling = float(controller.description.dt[0])
    for _ in range(samples):
        u = controller.step(x)
        controls.append(u.copy())
        x = controller.integrate(x, u, sampling)
    return np.array(controls)


@pytest.mark.few(1)
@pytest.mark.parametrize("name", EXAMPLES)
def test_closed_loops_agree_with_libm(name: str) -> None:
    require_tool("cc")
    pair = [build(EXAMPLES[name].build_ocp(), Options(math=which), "test") for which in ("libm", "own")]
    libm, own = (closed_loop(controller, EXAMPLES[name], 60) for controller in pair)
    assert np.ptp(libm) > 0
    np.testing.assert_allclose(own, libm, rtol=0, atol=1e-10 * np.abs(libm).max())


@pytest.mark.few(1)
@pytest.mark.parametrize("target", ["x86-64-v3", "x86-64-v4"])
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("name", ["crane", "cstr", "quadrotor"])
def test_closed_loops_in_lanes_have_the_same_bits(name: str, precision: Precision, target: str) -> None:
    """Without products of several steps, whose sums have another order in lanes."""
    require_target(target)
    options = [Options(math="own", precision=precision, target=t) for t in ("portable", target)]
    one, several = (build(EXAMPLES[name].build_ocp(), o, "verify") for o in options)
    np.testing.assert_array_equal(*(closed_loop(c, EXAMPLES[name], 40) for c in (one, several)))


def every_function() -> OCP:
    """A map with all functions that have a text of their own."""
    ocp = OCP("every", N=4)
    x, u = ocp.state("x", initial=0.3), ocp.control("u")
    small, large = 0.3 * ca.sin(x), 2 + ca.cos(x)
    terms = [f(small) for f in (ca.exp, ca.tan, ca.asin, ca.acos, ca.atan, ca.sinh, ca.cosh, ca.tanh, ca.asinh)]
    terms += [ca.acosh(large), ca.atanh(small), ca.log(large), ca.log1p(small), ca.expm1(small), ca.sqrt(large)]
    terms += [large**1.7, large**small, ca.atan2(small, large), ca.hypot(small, large), ca.fabs(x)]
    terms += [ca.fmod(x, large), ca.floor(x), ca.ceil(x), ca.fmin(x, u), ca.fmax(x, u), ca.copysign(x, u)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProblemWarning)  # the kinks are what the test is for
        ocp.dynamics({x: 0.01 * ca.sum1(ca.vertcat(*terms)) + u}, discrete=True)
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 1.0])
    return ocp


@pytest.mark.slow
@pytest.mark.few(1)
@pytest.mark.filterwarnings("ignore::nmpc_codegen.ProblemWarning")
@pytest.mark.parametrize("precision", ["double", "single"])
def test_a_package_with_every_function_needs_no_libm(precision: Precision) -> None:
    """It calls no function of the C library but those that copy memory, has no warnings, and gives what libm gives."""
    require_tool("cc")
    sources = generate(every_function(), Options(math="own", precision=precision))
    missing = own_names() - {n for n in own_names() if re.search(rf"\bown_{n}\(", sources["every.c"])}
    assert missing <= {"fabs"}
    assert "-lm" not in sources["README.md"]
    assert "PUBLIC m)" not in sources["CMakeLists.txt"]
    assert quality.warnings_of(sources, ("-O0",)) == ""
    with quality.written(sources) as folder:
        quality.compile_c(folder, *quality.RELEASE, "-c", "every.c", "-o", "every.o").check_returncode()
        listing = subprocess.run(["nm", "-u", "every.o"], cwd=folder, capture_output=True, text=True, check=True).stdout
        assert {line.split()[-1] for line in listing.splitlines()} <= {"memcpy", "memset", "memmove"}
        done = quality.compile_c(folder, *quality.RELEASE, "main.c", "every.c", "-o", "program")
        assert done.returncode == 0, done.stderr
    pair = [build(every_function(), Options(math=which, precision=precision), "test") for which in ("libm", "own")]
    x, u = np.array([0.3]), np.array([0.1])
    np.testing.assert_allclose(*(c.integrate(x, u, 1.0) for c in pair), rtol=1e-6 if precision == "single" else 1e-14)


def test_default_packages_contain_none() -> None:
    assert "own_" not in generate(crane.build_ocp())["crane.c"]
    assert "elementary functions" not in generate(crane.build_ocp())["crane.c"]


def test_only_what_is_called_is_contained() -> None:
    text = generate(crane.build_ocp(), Options(math="own"))["crane.c"]
    assert "own_sin(" in text
    assert "own_exp" not in text
    assert "own_pow" not in text


def test_an_operation_without_text_is_refused() -> None:
    ocp = OCP("curve", T=1.0, N=2)
    x, u = ocp.state("x", initial=0.3), ocp.control("u")
    ocp.dynamics({x: ca.erf(x) + u})
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 1.0])
    with pytest.raises(OptionError, match=r'math="own" \(--set math=own\) clashes with \w+\(\): erf has no text'):
        generate(ocp, Options(math="own"))
    assert "erf(" in generate(ocp)["curve.c"]


def test_other_clashes() -> None:
    with pytest.raises(OptionError, match=r'math="own" .* osqp, whose foreign code'):
        generate(crane.build_ocp(), Options(math="own", qp=Osqp()))
    with pytest.raises(OptionError, match=r"Options\.math: 'fast'; expected one of libm, own"):
        Options(math="fast")  # type: ignore[arg-type]
    with pytest.raises(OptionError, match=r"options\.math does not apply to derivatives"):
        derivatives.build(crane.build_ocp(), options=Options(math="own"))


def test_the_command_line(tmp_path: Path) -> None:
    assert main([crane.__file__, "-o", str(tmp_path), "--set", "math=own"]) == 0
    assert "own_sin(" in (tmp_path / "crane.c").read_text(encoding="utf-8")
