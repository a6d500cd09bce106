"""Random numbers of flights: known answers of the generator, the inverse distribution, moments."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import special, stats

from nmpc_codegen import ControllerError, Normal, Uniform
from nmpc_codegen.runtime.batch.driver import EXACT, part
from nmpc_codegen.runtime.batch.random import NOISE, DrawnSignal, Draws, draw, signal
from nmpc_codegen.runtime.build import load_library

PROBE = """
#include <math.h>
#include <stdint.h>
#include <stddef.h>
#include <string.h>
#define TARGET
#define PRODUCT(a, b) ((a) * (b))
"""
DECLARED = """/* begin declarations */
typedef struct { const double *size; int32_t uniform; int32_t stream; } batch_random_t;
void words(uint32_t *c, uint32_t k0, uint32_t k1);
double inverse(double p);
double log_of(double x);
/* end declarations */
"""
WRAPPERS = """
void words(uint32_t *c, uint32_t k0, uint32_t k1) { batch_philox(c, k0, k1); }
double inverse(double p) { return batch_normal(p); }
double log_of(double x) { return batch_logarithm(x); }
void unused(const batch_random_t *r, double *out) { batch_draw_sample(r, 0, 0, 0, 1, out); }
"""


@pytest.fixture(scope="module")
def probe() -> tuple:  # type: ignore[type-arg]
    text = PROBE + DECLARED + part("random.c") + WRAPPERS
    return load_library({"probe.h": DECLARED, "probe.c": text}, "probe", EXACT)


@pytest.mark.parametrize(
    ("counter", "key", "answer"),
    [
        ((0,) * 4, (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_known_answers_of_philox(probe, counter, key, answer) -> None:  # type: ignore[no-untyped-def]
    ffi, lib = probe
    words = ffi.new("uint32_t[4]", list(counter))
    lib.words(words, *key)
    assert tuple(words) == answer


def test_inverse_of_the_normal_distribution(probe) -> None:  # type: ignore[no-untyped-def]
    _, lib = probe
    p = np.concatenate([np.linspace(1e-6, 1 - 1e-6, 4001), 0.5 * 10.0 ** -np.arange(0.0, 16.0, 0.25)])
    np.testing.assert_allclose([lib.inverse(v) for v in p], special.ndtri(p), rtol=2e-14, atol=1e-16)
    x = np.concatenate([2.0 ** -np.arange(0.0, 60.0), np.linspace(0.01, 4, 997)])
    np.testing.assert_allclose([lib.log_of(v) for v in x], np.log(x), rtol=4e-16, atol=1e-17)


def test_numbers_are_those_of_flight_sample_and_state() -> None:
    for uniform, law in ((True, stats.uniform(-1, 2)), (False, stats.norm())):
        out = np.zeros((200, 3))
        drawn = []
        for flight in range(60):
            draw(DrawnSignal(np.array([1.0, 2.0, 0.5]), uniform, NOISE), 7, flight, out)
            drawn.append(out / [1.0, 2.0, 0.5])
        values = np.array(drawn)
        assert stats.kstest(values.ravel(), law.cdf).pvalue > 1e-3
        assert len(np.unique(values)) == values.size
        flat = values.reshape(60, -1)
        assert abs(np.corrcoef(flat[:-1].ravel(), flat[1:].ravel())[0, 1]) < 0.01
        again = np.zeros((200, 3))
        draw(DrawnSignal(np.array([1.0, 2.0, 0.5]), uniform, NOISE), 7, 59, again)
        np.testing.assert_array_equal(again, out)
        draw(DrawnSignal(np.array([1.0, 2.0, 0.5]), uniform, NOISE), 8, 59, again)
        assert not np.any(again == out)


def test_flights_are_drawn_by_their_number_wherever_a_batch_begins() -> None:
    sent = signal(Normal([1.0, 2.0]), "noise", ("x", "v"), NOISE)
    whole, rest = Draws(3, 0, 2, None, sent), Draws(3, 4, 2, None, sent)
    np.testing.assert_array_equal(rest.of(sent, 1, 6), whole.of(sent, 5, 6))
    assert not np.array_equal(rest.of(sent, 0, 6), whole.of(sent, 0, 6))


def test_signals() -> None:
    names = ("p", "r[0]", "r[1]")
    found = signal(Uniform({"r": [1.0, 2.0]}), "noise", names, NOISE)
    assert found is not None
    assert found.uniform
    np.testing.assert_array_equal(found.size, [0.0, 1.0, 2.0])
    other = signal(Normal(0.1), "noise", names, NOISE)
    assert other is not None
    np.testing.assert_array_equal(other.size, [0.1] * 3)
    for bad, message in (({"q": 1.0}, "no state 'q'"), (-1.0, "sizes >= 0"), ([1.0, 2.0], "has shape")):
        with pytest.raises(ControllerError, match=message):
            signal(bad, "noise", names, NOISE)
