"""What the reference takes from the running package: allowed values and defaults of options, meanings of statuses.

Docstrings are Markdown there, so that words in angle brackets are escaped. Of a component only its options are shown:
its other members are for whoever writes one.
"""

from __future__ import annotations

import dataclasses
import enum
import inspect
import re
from functools import reduce
from importlib import import_module
from typing import Any

import griffe

from nmpc_codegen.components.allowed import rules
from nmpc_codegen.components.integrators import ButcherTableau

_ATTRIBUTES = re.compile(r"^Attributes:\n(?: {4}.*\n?)+", re.MULTILINE)
_SPAN = re.compile(r"(``.*?``|`.*?`)")
#: What Markdown takes for an element; in an indented line, which may be code, only with its end.
_ELEMENT, _WHOLE_ELEMENT = re.compile(r"<(?=[A-Za-z])"), re.compile(r"<(?=\w+>)")


class Running(griffe.Extension):
    """Adds what only the running package knows to what griffe reads in its text."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Once per package, before griffe makes constructors of the fields of data classes."""
        for module in _modules(pkg):
            for found in module.members.values():
                if found.is_alias or not (found.is_class or found.is_function or found.is_attribute):
                    continue
                _escape(found)
                if found.is_class:
                    _complete(found)


def _modules(module: griffe.Module) -> list[griffe.Module]:
    """A module and all that are below it."""
    return [module, *(m for child in module.modules.values() if not child.is_alias for m in _modules(child))]


def _escape(found: Any) -> None:
    """The docstrings of an object and its members: words in angle brackets are text, the first paragraph is one line,
    which is what summaries show."""
    if found.docstring is not None:
        first, gap, rest = found.docstring.value.partition("\n\n")
        joined = first.replace("\n", " ") + gap + rest
        found.docstring.value = "\n".join(map(_escape_line, joined.split("\n")))
    for member in found.members.values() if found.is_class else ():
        if not member.is_alias:
            _escape(member)


def _escape_line(line: str) -> str:
    """A line of a docstring; spans of code stay as they are."""
    pattern = _WHOLE_ELEMENT if line.startswith("    ") else _ELEMENT
    return "".join(part if i % 2 else pattern.sub("&lt;", part) for i, part in enumerate(_SPAN.split(line)))


def _complete(found: griffe.Class) -> None:
    """Options with their rules, members of enumerations with their meanings."""
    cls = reduce(getattr, found.path.removeprefix(f"{found.module.path}.").split("."), import_module(found.module.path))
    _show_attributes_of_bases(found, cls)
    if dataclasses.is_dataclass(cls) and (any(rules(cls).values()) or hasattr(cls, "seam")):
        _show_options(found, cls)
    if issubclass(cls, enum.Enum):
        for word in cls:
            if word.name in found.members:
                text = f"{word.value}: {getattr(word, 'meaning', '') or word.words}."
                found.members[word.name].docstring = griffe.Docstring(text, parent=found.members[word.name])
    for name in [n for n, member in found.members.items() if not member.is_alias and _is_internal(member)]:
        found.del_member(name)


def _show_attributes_of_bases(found: griffe.Class, cls: type) -> None:
    """The section of attributes that a class without one has from a base."""
    sections = [s for base in cls.__mro__ if (s := _ATTRIBUTES.search(inspect.getdoc(base) or ""))]
    if found.docstring is not None and sections and "Attributes:" not in found.docstring.value:
        found.docstring.value += "\n\n" + sections[0][0]


def _is_internal(member: Any) -> bool:
    """True for what is public to other modules of the package only, as its docstring says."""
    return member.docstring is not None and "(internal)." in member.docstring.value.partition("\n")[0]


def _show_options(found: griffe.Class, cls: Any) -> None:
    """Defaults and allowed values as they are; no other members of a component."""
    defaults = {field.name: field.default for field in dataclasses.fields(cls)}
    for name, rule in rules(cls).items():
        if rule is None or name not in found.members:  # those of a base are shown there
            continue
        found.members[name].annotation = str(rule).partition("; on the command line")[0]
        found.members[name].value = repr_of(defaults[name])
    if hasattr(cls, "seam"):
        found.bases = []
        for name in [n for n in found.members if n not in rules(cls)]:
            found.del_member(name)


def repr_of(value: Any) -> str:
    """A default as it is written: a tableau by its name, another object by its class."""
    if isinstance(value, ButcherTableau):
        return value.name
    return f"{type(value).__name__}()" if dataclasses.is_dataclass(value) else repr(value)
