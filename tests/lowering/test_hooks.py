"""Hooks: one call for every feature that defines the function, in their order; nothing is left over."""

from __future__ import annotations

import re
from collections import Counter

import pytest

from nmpc_codegen.components.base import HOOKS
from nmpc_codegen.lowering.templates import template_directory
from nmpc_codegen.lowering.unit import hooks
from nmpc_codegen.lowering.unit.hooks import call_hooks, check_hooks
from nmpc_codegen.lowering.unit.item import Item
from verification.rendered import lowered, texts
from verification.samples import SAMPLES

HOOKED = ("hooked/shift.c", "hooked/nearness.c", "hooked/iterations.c")
PARTS = {path: path.read_text(encoding="utf-8") for path in template_directory().rglob("*.c")}
NAMED = sorted(path for path in PARTS if path.parent.name == "hooked")


def with_hooks(text: str, hooked_parts: tuple[str, ...]) -> str:
    """The text with the calls of hooks written out."""
    return call_hooks(Item("", "directive", text), hooked_parts).text


def test_a_call_of_a_hook_is_one_for_every_feature_that_defines_it() -> None:
    text = "    before_prepare(s);\n    status = after_feedback(s, status);\n    on_failure(s);\n"
    expected = ["    shift_before_prepare(s);"]
    expected += [f"    status = {name}_after_feedback(s, status);" for name in ("nearness", "iterations")]
    expected += ["    on_failure(s);"]
    assert with_hooks(text, HOOKED).splitlines() == expected
    assert with_hooks(text, HOOKED[::-1]).splitlines()[:3] == [expected[0], *expected[2:0:-1]]
    assert with_hooks(text, ()) == "    on_failure(s);\n"


def test_a_hook_that_is_no_statement_is_refused() -> None:
    with pytest.raises(ValueError, match=r"before_prepare\(\): expected the call of a hook as a statement"):
        with_hooks("    if (before_prepare(s)) {\n    }\n", HOOKED)


def test_hooks_that_would_not_run_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A name that is spelt wrong, and a hook that the algorithm does not state."""
    with pytest.raises(ValueError, match=r"barrier_rows\.c defines before_solve, follow_terms, place_terms, which the"):
        check_hooks("    before_steps(s);", ["hooked/barrier_rows.c"])
    check_hooks("    before_prepare(s);", ["hooked/shift.c"])
    monkeypatch.setattr(hooks, "read_part", lambda part: "static void late_on_rest(solver_t *s)\n{\n}\n")
    with pytest.raises(ValueError, match=r"late_on_rest\(\): expected a hook, on_reset"):
        check_hooks("", ["hooked/late.c"])


@pytest.mark.parametrize("hook", HOOKS)
def test_every_hook_is_called_and_defined(hook: str) -> None:
    assert any(re.search(rf"^ +(?:status = )?{hook}\(", text, re.MULTILINE) for text in PARTS.values())
    assert any(re.search(rf"\b{path.stem}_{hook}\(", PARTS[path]) for path in NAMED)


def test_a_function_of_a_part_is_a_hook_or_called() -> None:
    """A name that is spelt wrong would be a function that nothing reaches, which no package contains."""
    texts = [*PARTS.values(), *(p.read_text() for p in template_directory().rglob("*.jinja"))]
    mentioned = Counter(word for text in texts for word in re.findall(r"\w+", text))
    orphans = []
    for path, text in PARTS.items():
        for name in re.findall(r"^static [\w *]*?\(?\*?\b(\w+)\([^;{]*\)(?:\)\[\w+\])?\n\{", text, re.MULTILINE):
            hook = path in NAMED and name.removeprefix(f"{path.stem}_") in HOOKS
            printed = name.startswith("own_") or path.parent.name in ("lanes", "firmware") or path.name == "lookup.c"
            printed |= path.parent.name == "implicit" and name.startswith("implicit_")
            if not hook and not printed and mentioned[name] < 2:
                orphans.append(f"{path.name}: {name}")
    assert orphans == []


def test_features_that_a_package_lacks_leave_no_trace() -> None:
    sample = next(s for s in SAMPLES if s.name == "crane without solve")
    unit = texts(sample)["crane.c"]
    assert not [hook for hook in HOOKS if re.search(rf"\b(?!relaxation_|violation_|references_)\w*{hook}\(", unit)]
    module = lowered(next(s for s in SAMPLES if s.name == "everything dense"))
    assert [part.rpartition("/")[2] for part in module.hooked_parts][:3] == ["shift.c", "references.c", "relaxation.c"]
