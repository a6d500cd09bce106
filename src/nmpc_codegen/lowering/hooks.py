"""Hooks of an algorithm: a call for every feature that defines the function of a hook; without one, none."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache

from nmpc_codegen.components.base import HOOKS
from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.ir.print_c import CStyle
from nmpc_codegen.lowering.parts import read_part

_CALL = re.compile(rf"^(?P<before> *(?:\w+ = )?)(?P<hook>{'|'.join(HOOKS)})(?P<arguments>\(.*\);)$", re.MULTILINE)
_HEAD = r"^(static [\w ]*?\b{name}_(\w+)\([^{{]*?\))\n\{{"


@cache
def _hooks(part: str) -> Mapping[str, str]:
    """Hook -> head of its function, for those that a feature defines."""
    name, text = part.rpartition("/")[2].removesuffix(".c"), read_part(part, lambda path: "")
    heads = re.findall(_HEAD.format(name=name), text, re.MULTILINE)
    for _, word in heads:
        if word not in HOOKS and len(re.findall(rf"\b{name}_{word}\(", text)) < 2:
            raise ValueError(
                f"{part}: {name}_{word}(): expected a hook, {', '.join(HOOKS)}, or a function that it calls"
            )
    return {hook: f"{head};" for head, hook in heads if hook in HOOKS}


def check_hooks(texts: Iterable[str], extras: Sequence[str]) -> None:
    """Raise ValueError if a feature defines a hook that none of these parts states."""
    stated = {found["hook"] for text in texts for found in _CALL.finditer(text)}
    for part in extras:
        if missing := sorted(_hooks(part).keys() - stated):
            has = f"it has {', '.join(sorted(stated))}"
            raise ValueError(f"{part} defines {', '.join(missing)}, which the algorithm does not state; {has}")


def hook_prototypes(module: CModule, style: CStyle) -> str:
    """Declarations of the functions that features define for hooks."""
    heads = [head for part in module.extras for head in _hooks(part).values()]
    return "/* What features do at the hooks of the algorithm. */\n" + "\n".join(heads) + "\n" if heads else ""


def feature_parts(module: CModule, style: CStyle) -> str:
    """The files of the features."""
    return "\n\n".join(read_part(part, lambda path: "").rstrip("\n") for part in module.extras) + "\n"


def with_hooks(text: str, extras: Sequence[str]) -> str:
    """The text with the calls of hooks written out.

    Raises:
        ValueError: no feature defines a hook that one has to define, or several do.
    """
    defined = {part.rpartition("/")[2].removesuffix(".c"): _hooks(part) for part in extras}

    def calls(found: re.Match[str]) -> str:
        names = [f"{name}_{found['hook']}" for name, hooks in defined.items() if found["hook"] in hooks]
        if found["hook"] in ALONE and len(names) != 1:
            raise ValueError(f"{found['hook']}: expected one feature that defines it, found {names}")
        return "\n".join(f"{found['before']}{name}{found['arguments']}" for name in names) or _NOTHING

    return _GONE.sub("", _CALL.sub(calls, text))


#: Hooks that exactly one feature defines.
ALONE = ("prepare_plan",)

#: Stands for a line that goes.
_NOTHING = "\f"
_GONE = re.compile(r"\f\n")
