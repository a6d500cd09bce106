"""--set KEY=VALUE sets any option by its dotted name."""

from __future__ import annotations

import ast
import dataclasses
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from nmpc_codegen.components.allowed import rules, show
from nmpc_codegen.components.base import SEAMS
from nmpc_codegen.errors import OptionError
from nmpc_codegen.options import REGISTRIES, Options


@dataclass
class Change:
    """A change sets one option and options inside it together, because they may depend on each other."""

    given: bool = False
    value: Any = None
    inside: dict[str, Change] = field(default_factory=dict)


def registry(seam: str) -> Mapping[str, Any]:
    """Return the components of a seam: {word: class}."""
    return REGISTRIES[seam]


#: Spellings of other languages.
_TRUTH = {"true": True, "false": False}


def parse_value(text: str) -> Any:
    """Return a Python literal, true or false, else the text itself."""
    if text in _TRUTH:
        return _TRUTH[text]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return ast.literal_eval(text)
    except (ValueError, SyntaxError, TypeError, RecursionError, MemoryError):
        return text


def apply_settings(options: Options, settings: Sequence[tuple[str, str]]) -> Options:
    """Return ``options`` with the fields of all settings replaced at once; a later setting overrides an earlier one.

    Raises:
        OptionError: a field does not exist (the message lists the existing ones), or a value is not allowed.
    """
    root = Change()
    for key, text in settings:
        node = root
        for name in key.split("."):
            node = node.inside.setdefault(name.strip(), Change())
        node.given, node.value = True, parse_value(text)
    changed: Options = _change(options, root, "")
    return changed


def _change(part: Any, change: Change, where: str) -> Any:
    """Return a dataclass of options with the values of a change."""
    fields = rules(part)
    if where not in ("", *SEAMS) and not any(fields.values()):
        fields = {}  # a value such as a tableau is chosen as a whole
    new: dict[str, Any] = {}
    for name, inner in change.inside.items():
        key = f"{where}.{name}" if where else name
        if name not in fields:
            there = f"there is {', '.join(fields)}" if fields else "it has none"
            raise OptionError(f"{where or 'options'} has no option {name!r}; {there} (--set {key}=...)")
        value = getattr(part, name)
        if key in SEAMS:
            value = _component(key, inner.value) if inner.given else value
            value = _default(part, key, inner.inside) if value is None and inner.inside else value
        elif inner.given:
            rule = fields[name]
            value = inner.value if rule is None else rule.convert(inner.value)
        new[name] = _change(value, inner, key) if inner.inside else value
    return dataclasses.replace(part, **new) if new else part


def _takes(cls: Any, name: str, change: Change) -> bool:
    """Return True if the new value of an option is allowed."""
    rule = rules(cls)[name]
    return rule is None or not change.given or rule.takes(rule.convert(change.value))


def _component(seam: str, word: Any) -> Any:
    """Return the component with the given word and default options; None leaves the choice to the compiler."""
    if word is None:
        return None
    words = registry(seam)
    known = word.replace("-", "_") if isinstance(word, str) else word
    if not isinstance(known, str) or known not in words:
        raise OptionError(f"there is no {seam} {show(word)}; there is {', '.join(words)} (--set {seam}=WORD)")
    return words[known]()


#: Seam -> component to which an option belongs that several components have.
MEANT = {"integrator": "explicit_runge_kutta"}


def _default(options: Options, seam: str, names: Mapping[str, Change]) -> Any:
    """Return the algorithm's default component, else the one that has all these options with these values."""
    default = getattr(options.with_defaults, seam)
    return default if default is not None else _first_with(seam, names)


def _first_with(seam: str, names: Mapping[str, Change]) -> Any:
    """Return the component of a seam that has all these options.

    It is the only one, or the only one that allows their values, or the default of MEANT.
    """
    able = {word: cls for word, cls in registry(seam).items() if set(names) <= set(rules(cls))}
    taking = {word: cls for word, cls in able.items() if all(_takes(cls, n, change) for n, change in names.items())}
    for known in (able, taking):
        if len(known) == 1:
            return next(iter(known.values()))()
    if MEANT.get(seam) in able:
        return able[MEANT[seam]]()
    wanted = ", ".join(f"{seam}.{name}" for name in names)
    if able:
        raise OptionError(f"{wanted}: also give --set {seam}=WORD, with one of {', '.join(able)}")
    there = ", ".join(dict.fromkeys(name for cls in registry(seam).values() for name in rules(cls)))
    raise OptionError(f"{seam} has no option {' with '.join(map(repr, names))}; there is {there} (--set {wanted}=...)")
