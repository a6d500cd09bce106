"""The symbols of an OCP are SX with one extension: vectors, too, can be keys of a dictionary."""

from __future__ import annotations

import copy
import pickle

import casadi as ca
import numpy as np

from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.ocp import OCP


def test_vectors_and_scalars_are_keys() -> None:
    ocp = OCP("a", T=1.0, N=2)
    r, v = ocp.state("r", size=3), ocp.state("v", size=3)
    s, u, q = ocp.state("s"), ocp.control("u", size=3), ocp.parameter("q", size=3)
    ocp.dynamics({r: v, v: u + q, s: r[0]})
    ocp.least_squares(u, 1)
    f = classify(ocp).dynamics(range(1, 8), [10, 20, 30], [1, 2, 3])
    np.testing.assert_array_equal(f.full().ravel(), [4, 5, 6, 11, 22, 33, 1])
    assert {r: 1, v: 2, s: 3, u: 4, q: 5}[v] == 2
    assert len({r, v, r, s, u, q}) == 5


def test_a_symbol_is_an_sx_in_every_other_respect() -> None:
    r = OCP("a", T=1.0, N=2).state("r", size=2)
    assert isinstance(r, ca.SX)
    assert type(r[0]) is type(r + 1) is type(ca.sin(r)) is type(r.T) is ca.SX
    assert ca.Function("f", [r], [r[::-1]])([1, 2]).full().ravel().tolist() == [2, 1]
    assert ca.vertcat(r, 1).shape == (3, 1)
    assert bool(ca.is_equal(ca.substitute(r * 2, r, r + 1), 2 * (r + 1), 3))
    assert str(r == r + 0) == str(ca.SX(r) == ca.SX(r))
    assert bool((r >= 0).shape == (2, 1))
    for twin in (copy.copy(r), copy.deepcopy(r)):
        assert ca.is_equal(twin, r, 1)
        assert hash(twin) != hash(r)
    with ca.global_pickle_context():
        text = pickle.dumps(r)
    with ca.global_unpickle_context():
        assert pickle.loads(text).shape == (2, 1)
