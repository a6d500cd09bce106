"""Hooks of an algorithm: a call for every extra that defines the function of a hook; without one, none."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache, lru_cache

from nmpc_codegen.components.base import HOOKS
from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.ir.printing.c_style import CStyle
from nmpc_codegen.lowering.parts import read_part
from nmpc_codegen.lowering.pruning.scopes import signature
from nmpc_codegen.lowering.pruning.tree import Edit, edit, margin, parse

_CALL = re.compile(rf"(?P<before>(?:\w+ = )?)(?P<hook>{'|'.join(HOOKS)})(?P<arguments>\(.*\);)", re.DOTALL)
_NAMED = re.compile(rf"\b(?:{'|'.join(HOOKS)})\(")

#: Hooks that exactly one extra defines.
ALONE = ("prepare_plan",)


@cache
def _hooks(part: str) -> Mapping[str, str]:
    """Hook -> head of its function, for those that an extra defines."""
    extra, text = part.rpartition("/")[2].removesuffix(".c"), read_part(part, lambda path: "")
    found = {}
    for node in parse(text):
        head = text[slice(*node.head)].strip() if node.kind == "function" else ""
        name = signature(head)[0] if head else ""
        word = name.removeprefix(f"{extra}_")
        if word in HOOKS and word != name:
            found[word] = f"{head};"
        elif word != name and len(re.findall(rf"\b{name}\(", text)) < 2:
            raise ValueError(f"{part}: {name}(): expected a hook, {', '.join(HOOKS)}, or a function that it calls")
    return found


def check_hooks(texts: Iterable[str], extras: Sequence[str]) -> None:
    """Raise ValueError if an extra defines a hook that none of these parts states."""
    stated = {hook for text in texts for hook in HOOKS if re.search(rf"^ *(?:\w+ = )?{hook}\(", text, re.MULTILINE)}
    for part in extras:
        if missing := sorted(_hooks(part).keys() - stated):
            has = f"it has {', '.join(sorted(stated))}"
            raise ValueError(f"{part} defines {', '.join(missing)}, which the algorithm does not state; {has}")


def hook_prototypes(module: CModule, style: CStyle) -> str:
    """Declarations of the functions that extras define for hooks."""
    heads = [head for part in module.extras for head in _hooks(part).values()]
    return (
        "/* What else happens in a sample, at the hooks of the algorithm. */\n" + "\n".join(heads) + "\n"
        if heads
        else ""
    )


def extra_parts(module: CModule, style: CStyle) -> str:
    """The files of the extras."""
    return "\n\n".join(read_part(part, lambda path: "", module.decided).rstrip("\n") for part in module.extras) + "\n"


def with_hooks(text: str, extras: Sequence[str]) -> str:
    """The text with the calls of hooks written out.

    Raises:
        ValueError: no extra defines a hook that needs a definition, or several extras define it.
    """
    pieces = [text] if "#endif" in text else re.split(r"(?<=\n\}\n)", text)
    return "".join(_call_hooks(piece, tuple(extras)) if _NAMED.search(piece) else piece for piece in pieces)


@lru_cache(maxsize=1024)
def _call_hooks(text: str, extras: tuple[str, ...]) -> str:
    """The same of a text that ends with a function."""
    named = {part.rpartition("/")[2].removesuffix(".c"): _hooks(part) for part in extras}
    edits = []
    for node in (n for top in parse(text) for n in top.walk() if n.kind == "statement"):
        call = _CALL.fullmatch(text, node.start, node.end)
        if call is None:
            continue
        names = [f"{name}_{call['hook']}" for name, hooks in named.items() if call["hook"] in hooks]
        if call["hook"] in ALONE and len(names) != 1:
            raise ValueError(f"{call['hook']}: expected one extra that defines it, found {names}")
        before = margin(text, node)
        lines = [f"{before}{call['before']}{name}{call['arguments']}\n" for name in names]
        edits.append(Edit(node.start - len(before), node.end + 1, "".join(lines)))
    return edit(text, edits)
