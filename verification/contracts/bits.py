"""Contracts of copies: the samples of a controller have the same bits, whatever object holds it."""

from __future__ import annotations

import pickle
import tempfile
from pathlib import Path

import numpy as np

from nmpc_codegen import Batch, Controller, Recorder, open_recording
from verification import whole
from verification.contracts.subject import Array, Subject

SAMPLES = 5


def fly(controller: Controller, subject: Subject, first: int = 0, samples: int = SAMPLES) -> Array:
    """Return the controls (samples, nu) at measured states; state number 2 is NaN."""
    u = []
    for k in range(first, first + samples):
        x = subject.measured(k)
        x[0] = np.nan if k == 2 else x[0]
        u.append(controller.step(x))
    return np.array(u)


def copies_have_the_same_bits(subject: Subject) -> None:
    """Assert that a copy and a pickle, made in mid-run, compute the same samples, and that none changes another."""
    controller = subject.controller()
    fly(controller, subject, samples=3)
    before = bytes(controller)
    twins = [controller.copy(), pickle.loads(pickle.dumps(controller))]
    u = fly(controller, subject, 3)
    for twin in twins:
        assert bytes(twin) == before
        np.testing.assert_array_equal(fly(twin, subject, 3), u)
        assert bytes(twin) == bytes(controller)


def a_batch_has_the_bits_of_its_controllers(subject: Subject) -> None:
    """Assert that every byte of every struct is equal after samples by two threads, solutions and shifts."""
    first = subject.controller()
    many, singles = Batch(first, 3, 2), [first.copy() for _ in range(3)]
    for k in range(SAMPLES):
        X = np.array([subject.measured(3 * k + i) for i in range(3)])
        X[k % 3] = np.nan if k == 2 else X[k % 3]
        u, status = many.step(X)
        np.testing.assert_array_equal(u, [one.step(x) for one, x in zip(singles, X, strict=True)])
        np.testing.assert_array_equal(status, [one.status for one in singles])
        for one, single in zip(many, singles, strict=True):
            assert bytes(one) == bytes(single)
    if subject.options.solves:
        status = many.solve(X, max_iterations=20)
        alone = [one.solve(x, max_iterations=20) for one, x in zip(singles, X, strict=True)]
        np.testing.assert_array_equal(status, [each.status for each in alone])
    many.shift()
    for one in singles:
        one.shift()
    for name in ("x", "u", "cost"):  # Batch.solve() iterates in one C call
        np.testing.assert_allclose(getattr(many, name), [getattr(one, name) for one in singles], rtol=1e-9, atol=1e-9)


def a_recording_replays(subject: Subject) -> None:
    """Assert that a recording has states, controls and statuses of its loop, and that another controller repeats it."""
    flown, other = subject.controller(), subject.controller()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.rec"
        with Recorder(flown, file=file) as recorder:
            u = [recorder.step(subject.measured(k)) for k in range(SAMPLES)]
        log = open_recording(file, flown)
    np.testing.assert_array_equal(log.u, u)
    for k in range(SAMPLES):
        np.testing.assert_array_equal(log.x[k], subject.measured(k).astype(flown.x.dtype))
        np.testing.assert_array_equal(other.step(log.x[k]), log.u[k])
        assert log.status[k] == other.status


def the_package_does_what_the_whole_text_does(subject: Subject) -> None:
    """Assert that loops of the exported unit and of the full text, before anything is left out, agree to the bit."""
    package, complete = whole.packages(subject.sample)
    assert whole.errors_of(complete) == ""
    ours, theirs = (whole.closed_loop(text).splitlines() for text in (package, complete))
    assert len(ours) >= SAMPLES
    assert ours == theirs
