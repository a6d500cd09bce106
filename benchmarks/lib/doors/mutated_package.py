"""Mutated package descriptions, and a use of the controller that touches every buffer: effects of hostile JSON.

    python -m benchmarks.lib.doors.mutated_package FOLDER FIRST END     one line "<k> <outcome> <label>" per mutation
    python -m benchmarks.lib.doors.mutated_package FOLDER              read outside a buffer: does the sanitizer see it?

Mutation number k is a function only of k and of the text. Run under AddressSanitizer (doors_trust.py), a read or
write outside a buffer kills the process; the last line then identifies the mutation.
"""

from __future__ import annotations

import copy
import io
import itertools
import json
import pickle
import random
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from nmpc_codegen import Controller, NmpcError, open_package, simulate
from nmpc_codegen.runtime.build import Profile

SANITIZED = Profile("asan", ("-O1", "-g", "-fsanitize=address", "-fno-omit-frame-pointer"))
NUMBERS = (0, 1, -1, 2, 3, 7, 60, 1000, 2**31, -(2**31), 2**63, 10**400, 1.5, -0.0, 1e308, True)
OTHERS = (None, "", "x", "inf", "nan", "\ud800", [], {}, [1], [[[]]], {"a": 1}, "solver", "real", "int64", "a b")
TEXTS = ("NaN", "-Infinity", "1e999", "\x00", '"', "[", "]" * 5, "[" * 100_000, ",", "{", "9" * 5000, "\ud7ff", "null")

Place = tuple[Any, Any]  # container, key or index


def mutate(text: str, k: int) -> tuple[str, str]:
    """(description of the change, mutated text) number k."""
    rng = random.Random(k)
    if k % 8 == 7:
        return _mutate_text(text, rng)
    whole = json.loads(text)
    if k % 4 == 1:
        return _lie(whole, rng), json.dumps(whole)
    places = [p for p in _places(whole) if rng.random() < 0.5 or not isinstance(p[0], list)]
    kind = rng.choice(sorted(_STRUCTURED))
    for _ in range(50):
        container, key = rng.choice(places)
        old = copy.deepcopy(container[key])
        what = _STRUCTURED[kind](container, key, rng)
        if what:
            return f"{kind} {key!r}: {str(old)[:30]!r} {what}", json.dumps(whole)
    return f"{kind}: nowhere", json.dumps(whole)


def _places(value: Any) -> Iterator[Place]:
    keys = value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    for key in keys:
        if key not in ("report", "doc"):
            yield value, key
            yield from _places(value[key])


def _number(container: Any, key: Any, rng: random.Random) -> str:
    if not isinstance(container[key], int | float) or isinstance(container[key], bool):
        return ""
    steps = (container[key] + 1, container[key] - 1, container[key] * 2, -container[key])
    container[key] = rng.choice((*NUMBERS, *steps, *steps, *steps))
    return f"-> {str(container[key])[:30]}"


def _type(container: Any, key: Any, rng: random.Random) -> str:
    container[key] = rng.choice(OTHERS)
    return f"-> {container[key]!r}"


def _length(container: Any, key: Any, rng: random.Random) -> str:
    items = container[key]
    if not isinstance(items, list):
        return ""
    if items and rng.random() < 0.5:
        items.pop(rng.randrange(len(items)))
        return "one less"
    items.insert(rng.randint(0, len(items)), copy.deepcopy(rng.choice(items)) if items else 1)
    return "one more"


def _order(container: Any, key: Any, rng: random.Random) -> str:
    items = container[key]
    if not isinstance(items, list) or len(items) < 2:
        return ""
    i, j = rng.sample(range(len(items)), 2)
    items[i], items[j] = items[j], items[i]
    return f"{i} <-> {j}"


def _name(container: Any, key: Any, rng: random.Random) -> str:
    if not isinstance(container[key], str):
        return ""
    container[key] = rng.choice(
        ("", "a b", "x'", "é", "p", "real", "int32", "shared", "node", "general", "class", "kkt")
    )
    return f"-> {container[key]!r}"


def _key(container: Any, key: Any, rng: random.Random) -> str:
    if not isinstance(container, dict):
        return ""
    value = container.pop(key)
    if rng.random() < 0.5:
        container[f"{key}_"] = value
        return "renamed"
    return "removed"


_STRUCTURED: dict[str, Callable[[Any, Any, random.Random], str]] = {
    "number": _number,
    "another number": _number,
    "type": _type,
    "length": _length,
    "order": _order,
    "name": _name,
    "key": _key,
}


def _lie(whole: dict[str, Any], rng: random.Random) -> str:
    """A change of a size with all its consequences, so that only the compiled code can reveal it."""
    sizes, change = whole["sizes"], rng.choice((-1, 1, 2, 60))
    kind, macro = rng.choice(
        (("states", "NX"), ("controls", "NU"), ("parameters", "NP"), ("y_names", "NY"), ("rows", "NR"))
    )
    if kind in ("rows", "y_names") and whole[kind]:
        last = whole[kind].pop()
        more = [{**last, "name": f"row_{i}"} if kind == "rows" else f"y_{i}" for i in range(max(0, change + 1))]
        whole[kind] += more
        sizes[macro] = len(whole[kind])
        return f"lie: {sizes[macro]} {kind}"
    signals = whole[kind]
    _resize(signals[0], max(1, signals[0]["size"] + change))
    if len(signals) > 1 and rng.random() < 0.5:  # the others take the same sizes as the first one
        _resize(signals[1], max(1, sizes[macro] - signals[0]["size"] - sum(s["size"] for s in signals[2:])))
    for before, after in itertools.pairwise(signals):
        after["offset"] = before["offset"] + before["size"]
    sizes[macro] = sum(s["size"] for s in signals)
    if kind == "controls":
        for row in whole["rows"]:
            row["index"] = 0 if row["kind"] == "control" else row["index"]
    return f"lie: {kind} of sizes {[s['size'] for s in signals]}"


def _resize(signal: dict[str, Any], size: int) -> None:
    signal |= {"size": size, "scalar": False, "value": [0.0] * size}


def _mutate_text(text: str, rng: random.Random) -> tuple[str, str]:
    at = rng.randrange(len(text))
    if rng.random() < 0.2:
        return f"text: cut at {at}", text[:at]
    if rng.random() < 0.3:
        line = rng.choice(text.splitlines(keepends=True))
        return f"text: line {line.strip()[:20]!r} twice", text.replace(line, line + line, 1)
    piece = rng.choice(TEXTS)
    return f"text: {piece[:10]!r} at {at}", text[:at] + piece + text[at + rng.randint(0, 2) :]


def use(ctrl: Controller) -> None:
    """Call every function that reads or writes memory; the caller handles refusals."""
    d, x0 = ctrl.dims, ctrl.description.x_initial
    calls: list[Callable[[], Any]] = [
        *(lambda: ctrl.step(x0), lambda: ctrl.prepare(), lambda: ctrl.feedback(x0), lambda: ctrl.shift()),
        *(lambda: ctrl.solve(x0, max_iterations=3), lambda: ctrl.kkt(), lambda: ctrl.cost, lambda: ctrl.stats),
        lambda: ctrl.integrate(x0, np.zeros(d.nu), 0.01),
        *(lambda: ctrl.set_reference(np.zeros(d.ny)), lambda: ctrl.set_reference(np.zeros((d.N, d.ny)))),
        *(lambda: ctrl.set_weight(np.ones(d.ny)), lambda: ctrl.set_weight(np.eye(d.ny), node=d.N - 1)),
        lambda: ctrl.set_reference(dict.fromkeys(ctrl.names.y, 0.5)),
        lambda: ctrl.set_terminal_reference(np.zeros(d.ny_N)),
        lambda: ctrl.set_terminal_weight(np.ones(d.ny_N)),
        *(lambda s=s: ctrl.set_parameter(s.name, np.ones(s.size)) for s in ctrl.description.parameters),
        *(lambda s=s: ctrl.set_parameter(s.name, np.ones(s.size), node=d.N) for s in ctrl.description.parameters),
        *(lambda r=r: ctrl.set_bounds(r, -1.0, 1.0) for r in ctrl.names.rows),
        *(
            lambda i=i: ctrl.path_bounds(i)
            for i in range(len(ctrl.names.rows))
            if len(ctrl.description.rows[i].nodes) > 1
        ),
        *(lambda m=m: _rewrite(ctrl.copy(), m.name) for m in ctrl.description.members("solver").values()),
        *(lambda: pickle.loads(pickle.dumps(ctrl)).step(x0), lambda: ctrl.copy().step(x0)),
        *(lambda: _saved(ctrl), lambda: simulate(ctrl, x0, 2).summary(), lambda: repr(ctrl), lambda: ctrl.reset()),
    ]
    for call in calls:
        try:
            call()
        except NmpcError as error:
            _check_sentence(error)


def _rewrite(ctrl: Controller, name: str) -> None:
    view = ctrl.view(name)
    view[...] = np.zeros_like(view) if view.dtype.names else view + view.dtype.type(1)


def _saved(ctrl: Controller) -> None:
    file = io.BytesIO()
    ctrl.save(file)
    file.seek(0)
    ctrl.load(file)


def _check_sentence(error: NmpcError) -> None:
    if not str(error).strip() or "\n" in str(error) or len(str(error)) > 2000:
        raise AssertionError(f"no sentence: {str(error)[:200]!r}")


def outcome(folder: Path, name: str, text: str, profile: Any) -> str:
    """Outcome for a package with this description: refused, opened, or the name of an error that must not occur."""
    (folder / f"{name}.json").write_text(text, encoding="utf-8", errors="surrogatepass")
    try:
        ctrl = open_package(folder, profile)
    except NmpcError as error:
        _check_sentence(error)
        return "refused"
    except Exception as error:
        return f"wrong:{type(error).__name__}"
    try:
        use(ctrl)
    except Exception as error:
        return f"wrong-in-use:{type(error).__name__}"
    return "opened"


def overrun(source: str) -> None:
    """Let C read a reference that is too short, which the sanitizer has to report."""
    ctrl = open_package(source, SANITIZED)
    package = ctrl._package
    package.function("set_reference")(ctrl._s, 0, package.ffi.from_buffer(f"{package.name}_real[]", np.zeros(1)))


def main(source: str, first: str, end: str) -> None:
    """Print the outcomes of the mutations first .. end - 1 of the package in a folder; see doors_trust.py."""
    name = next(Path(source).glob("*.json")).stem
    text = (Path(source) / f"{name}.json").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "package"
        shutil.copytree(source, folder)
        if outcome(folder, name, text, SANITIZED) != "opened":
            raise SystemExit("the package itself does not open")
        for k in range(int(first), int(end)):
            label, mutated = mutate(text, k)
            print(k, end=" ", flush=True)
            print(outcome(folder, name, mutated, SANITIZED), ascii(label), flush=True)


if __name__ == "__main__":
    overrun(sys.argv[1]) if len(sys.argv) == 2 else main(*sys.argv[1:])
