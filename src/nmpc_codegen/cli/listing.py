"""--list-options prints every component, its options, their defaults and allowed values."""

from __future__ import annotations

from typing import Any

from nmpc_codegen.cli.printing import Printer
from nmpc_codegen.cli.settings import registry
from nmpc_codegen.components.allowed import rules
from nmpc_codegen.components.base import SEAMS
from nmpc_codegen.options import Options


def list_options(printer: Printer) -> None:
    """Print the components of every seam, then the other options."""
    defaults = Options().with_defaults
    for seam in SEAMS:
        chosen = getattr(defaults, seam)
        default = "chosen from the problem" if chosen is None else chosen.name
        words = [*registry(seam), *(["None"] if chosen is None else [])]
        printer.line(f"{seam} = {default}; one of {', '.join(words)}", "bold")
        for word, cls in registry(seam).items():
            printer.line(f"  --set {seam}={word}    {cls.__name__}: {_first_line(cls)}")
            _list(printer, cls(), seam)
    for name, rule in rules(defaults).items():
        value = getattr(defaults, name)
        if name in SEAMS:
            continue
        if rules(value):
            printer.line(name, "bold")
            _list(printer, value, name)
        else:
            printer.line(f"{name} = {value}; {rule}", "bold")


def _list(printer: Printer, part: Any, key: str) -> None:
    """Print the options of a part, and the options inside them."""
    for name, rule in rules(part).items():
        value = getattr(part, name)
        printer.line(f"      {key}.{name} = {_short(value, rule)}" + (f"; {rule}" if rule is not None else ""))
        if any(rules(value).values()):
            _list(printer, value, f"{key}.{name}")


def _short(value: Any, rule: Any) -> str:
    """Return the word for a value that has one, else the value."""
    words = getattr(rule, "words", ())
    named = [word for word in words if words[word] == value] if isinstance(words, dict) else []
    return named[0] if named else str(value)


def _first_line(cls: Any) -> str:
    return (cls.__doc__ or "").strip().partition("\n")[0]
