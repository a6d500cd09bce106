"""Batches on a device: the kernel on the processor, thread by thread; compiled for a GPU; and on one, where one is."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest

from examples.crane import build_ocp
from nmpc_codegen import (
    OCP,
    Batch,
    Controller,
    ControllerError,
    NoCondensing,
    Options,
    Osqp,
    RiccatiInteriorPoint,
    Uniform,
    batch,
    build,
)
from nmpc_codegen.errors import BuildError, ExtraError
from nmpc_codegen.runtime.batch.cuda import BEGIN
from nmpc_codegen.runtime.batch.device import DeviceBatch, check_package, kernel_text, mark_noinline
from nmpc_codegen.runtime.batch.nvrtc import compile_kernel
from nmpc_codegen.runtime.native import native
from nmpc_codegen.targets import PORTABLE
from tests.runtime.batch.emulated import Emulated
from tests.runtime.batch.problems import N, car, reactor
from tests.runtime.batch.test_flights import GAINS, MASSES, STEPS, TRACKS, VARIANTS, X0

F = len(X0)
RNG = np.random.default_rng(4)


def both(ocp: OCP, options: Options | None = None, number: int = F) -> tuple[Batch, DeviceBatch]:
    """Batches of the same controller on the processor and on the device."""
    ctrl = build(ocp, options, "test")
    return Batch(ctrl, number), DeviceBatch(ctrl, number, Emulated(7))


def same(host: Batch, device: DeviceBatch) -> None:
    """Every byte of every struct is that of the batch on the processor."""
    for i, one in enumerate(host):
        np.testing.assert_array_equal(one._memory, device[i]._memory)


@pytest.mark.few(3)
@pytest.mark.parametrize("name", VARIANTS)
def test_calls(name: str) -> None:
    host, device = both(*VARIANTS[name])
    x = X0.astype(host.description.real)
    for k in range(4):
        x[k] = np.nan if k == 2 else x[k]
        (u, status), (v, other) = host.step(x), device.step(x)
        np.testing.assert_array_equal(u, v)
        np.testing.assert_array_equal(status, other)
        moved = host.integrate(x, u, 0.25)
        np.testing.assert_array_equal(moved, device.integrate(x, v, 0.25))
        same(host, device)
        x = np.where(np.isfinite(moved), moved, x)
    np.testing.assert_array_equal(host.cost, device.cost)
    np.testing.assert_array_equal(host.status, device.status)
    host.reset(np.arange(F) % 3 == 0)
    device.reset(np.arange(F) % 3 == 0)
    np.testing.assert_array_equal(host.solve(X0), device.solve(X0))
    same(host, device)


def test_phases_and_views() -> None:
    host, device = both(car(rate=True))
    np.testing.assert_array_equal(host.prepare(), device.prepare())
    for one, other in zip(host.feedback(X0), device.feedback(X0), strict=True):
        np.testing.assert_array_equal(one, other)
    host.shift()
    device.shift()
    for part in ("x", "u", "lam", "mu_x", "mu_u", "mu", "mu_N", "eta", "stats"):
        np.testing.assert_array_equal(getattr(host, part), getattr(device, part))
    for many in (host, device):
        many.x = np.full((F, N + 1, 4), 0.5)
        many.mu_u = np.full((F, N, 1), 0.25)
        many.mu_x = np.zeros((F, N + 1, 4))
    same(host, device)
    with pytest.raises(AttributeError, match="has no 'y'"):
        device.view("y")


def test_data() -> None:
    host, device = both(car())
    for many in (host, device):
        many.set_parameter("m", MASSES[:, 0])
        many.set_reference({"p": 0.3}, index=[1, 4])
        many.set_weight(np.linspace(0.5, 1, 5))
        many.set_bounds("a", -1.5, np.linspace(1, 2, F))
    same(host, device)
    with pytest.raises(ControllerError, match="no parameter 'mass'"):
        device.set_parameter("mass", 1.0)
    same(host, device)


@pytest.mark.parametrize("name", VARIANTS)
def test_flights(name: str) -> None:
    host, device = both(*VARIANTS[name])
    task: dict[str, Any] = {
        "parameters": {"m": MASSES, "k": GAINS},
        "references": {"p": TRACKS},
        "bounds": {"a": (-1.5, np.linspace(1.0, 2.0, STEPS))},
        "disturbance": 0.01,
        "noise": Uniform({"v": 0.02}),
        "added": 0.01 * RNG.normal(size=(F, STEPS, 4)),
        "plant_parameters": {"k[1]": 0.3},
        "seed": 5,
        "record": True,
    }
    one, other = host.simulate(X0, STEPS, **task), device.simulate(X0, STEPS, **task)
    single = DeviceBatch(build(*VARIANTS[name], "test"), 1, Emulated(7)).simulate(X0, STEPS, **task)
    for part in ("x", "u", "status", "status_counts", "failed", "lost", "cost", "violation", "last"):
        np.testing.assert_array_equal(getattr(one, part), getattr(other, part))
        np.testing.assert_array_equal(getattr(one, part), getattr(single, part))
    same(host, device)


def test_plants_and_algebraic_variables() -> None:
    host, device = both(reactor())
    starts = np.linspace(0.2, 1.5, F)[:, None]
    one, other = host.simulate(starts, 10, plant=host[0].copy()), device.simulate(starts, 10, plant=device[0])
    np.testing.assert_array_equal(one.violation, other.violation)
    assert one.violation.max() > 0.01
    again = device.simulate(starts, 3, plant=DeviceBatch(host[0], F, Emulated()))
    np.testing.assert_array_equal(again.last, host.simulate(starts, 3, plant=Batch(host[0], F)).last)
    with pytest.raises(ControllerError, match="of the same package"):
        device.simulate(starts, 3, plant=build(reactor(), Options(solve=False), "test"))


def test_bad_input() -> None:
    device = DeviceBatch(build(car(), None, "test"), 2, Emulated())
    with pytest.raises(ControllerError, match=r"X has shape \(3, 4\); expected \(2, 4\)"):
        device.step(np.zeros((3, 4)))
    with pytest.raises(IndexError, match="controller 2 of 2"):
        device[2]
    with pytest.raises(ControllerError, match="number is 0"):
        DeviceBatch(device[0], 0, Emulated())
    assert "on a device" in repr(device)


def test_only_large_functions_keep_their_calls() -> None:
    body = ["{", *["    x();"] * 9, "}"]
    lines = ["static void f(int a,", "    int b)", *body, "", "static inline int g(void)", *body]
    lines += ["", "status_t API(h)(void)", *body, "", "static int small(void)", "{", "    return 1;", "}"]
    found = mark_noinline(lines)
    assert [line for line in found if "__noinline__" in line] == [
        "static __noinline__ void f(int a,",
        "__noinline__ status_t API(h)(void)",
    ]
    assert [line.replace("__noinline__ ", "") for line in found] == lines


needs_nvrtc = pytest.mark.skipif(find_spec("nvidia") is None, reason="no NVRTC: pip install 'nmpc-codegen[cuda]'")


@pytest.mark.slow
@needs_nvrtc
def test_a_small_package_compiles_for_a_gpu(toy: Controller) -> None:
    path = compile_kernel(kernel_text(toy._package, BEGIN), "sm_90", exact=False)
    code = path.read_bytes()
    assert code[:4] == b"\x7fELF"
    assert b"batch_all" in code
    with pytest.raises(BuildError, match=r"NVRTC refuses the kernel:\nkernel.cu\(1\): error"):
        compile_kernel("wrong;", "sm_90", exact=True)


@pytest.mark.slow
@needs_nvrtc
@pytest.mark.parametrize("precision", ["double", "single"])
def test_the_crane_compiles_for_a_gpu(precision: Any) -> None:
    ctrl = build(build_ocp(), Options(precision=precision), "test")
    assert compile_kernel(kernel_text(ctrl._package, BEGIN), "sm_90", exact=True).stat().st_size > 100_000


def test_without_a_gpu() -> None:
    """What is missing has a name, and a call says how to get it."""
    if find_spec("cupy") is None:
        with pytest.raises(ExtraError, match=r"needs the package cupy: pip install 'nmpc-codegen\[cuda\]'"):
            batch(build(car(), None, "test"), 2, device="cuda")
    with pytest.raises(ControllerError, match="device is 'tpu'; allowed: 'cpu', 'cuda'"):
        batch(build(car(), None, "test"), 2, device="tpu")  # type: ignore[arg-type]


def test_what_a_device_does_not_run() -> None:
    interior = build(car(), Options(qp=RiccatiInteriorPoint(), condensing=NoCondensing()), "test")
    with pytest.warns(RuntimeWarning, match="diverge in its interior point; an active-set method suits them"):
        check_package(interior._package)
    check_package(build(car(), None, "test")._package)
    osqp = build(build_ocp(), Options(qp=Osqp()), "test")
    with pytest.raises(ControllerError, match="a QP solver of other authors"):
        check_package(osqp._package)
    if native() != PORTABLE:
        lanes = build(car(), Options(target="native"), "test")
        with pytest.raises(ControllerError, match=r"has the target .*; a device runs 'portable'"):
            check_package(lanes._package)


@pytest.mark.gpu
def test_on_a_gpu() -> None:
    """States and statuses are those of the processor, to the bit with functions of ours and without contraction."""
    ctrl = build(car(), Options(math="own"), "verify")
    host, device = batch(ctrl, F), batch(ctrl, F, device="cuda")
    one, other = host.simulate(X0, STEPS, disturbance=0.01), device.simulate(X0, STEPS, disturbance=0.01)
    np.testing.assert_array_equal(one.status_counts, other.status_counts)
    np.testing.assert_array_equal(one.last, other.last)
    for part, again in zip(host.step(X0), device.step(X0), strict=True):
        np.testing.assert_array_equal(part, again.get())
