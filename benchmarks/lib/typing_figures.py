"""Typing of the seams and order of the rooms.

untyped_options: fields, and signatures of public methods, of options, components, Model and CModule that contain Any,
object or a dict with string keys.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
import sys
from collections.abc import Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any

from benchmarks.lib.rooms import MODULES, SOURCE, modules_per_room, place, upward_imports

if TYPE_CHECKING:
    from benchmarks.lib.report import Report

UNTYPED = re.compile(r"\b(Any|object)\b|\bdict\[str\b")

#: Modules whose public classes are checked, besides all components. allowed.py checks the input of users, so that it
#: has to accept any value.
VALUES = ("ir.model", "ir.cmodule", "lowering.linearize")
GATE = "components.allowed"
OPTIONS = ("Options", "Online")


def measure(report: Report) -> None:
    """Add the figures."""
    report.add("untyped_options", len(untyped_options()), "annotations", n=len(classes()), limit=0, profile="exact")
    upward = sum(len(upward_imports(path)) for path in MODULES)
    report.add("upward_imports", upward, "imports", n=len(MODULES), limit=0, profile="exact")
    for folder, count in modules_per_room().items():
        name = folder.relative_to(SOURCE).as_posix()
        report.add("modules_per_room_max", count, "modules", case=name, limit=14, profile="exact")


def classes() -> list[type]:
    """The classes that describe the data of users and components."""
    names = [place(path).replace("/", ".").removesuffix(".__init__") for path in MODULES]
    names = [name for name in names if (name.startswith("components.") and name != GATE) or name in VALUES]
    found = [cls for name in names for cls in _defined(name) if not cls.__name__.startswith("_")]
    return found + [cls for cls in _defined("options") if cls.__name__ in OPTIONS]


def untyped_options() -> list[str]:
    """Every place without a type: ``Options.integrator: Any``."""
    return [place for cls in classes() for place in untyped(cls)]


def untyped(cls: type) -> list[str]:
    """The same for one class."""
    return [f"{cls.__name__}.{name}: {text}" for name, text in _annotations(cls) if _is_untyped(cls, text)]


def _defined(module: str) -> list[type]:
    name = f"nmpc_codegen.{module}"
    members = vars(importlib.import_module(name)).values()
    return [member for member in members if inspect.isclass(member) and member.__module__ == name]


def _annotations(cls: type) -> Iterator[tuple[str, str]]:
    """(member, text of an annotation) of the fields and public methods that a class itself defines."""
    yield from vars(cls).get("__annotations__", {}).items() if dataclasses.is_dataclass(cls) else ()
    for name, member in vars(cls).items():
        if not name.startswith("_"):
            for text in getattr(_function(member), "__annotations__", {}).values():
                yield name, text


def _function(member: Any) -> Any:
    """The function of a property, a class method or a static method."""
    if isinstance(member, property):
        return member.fget
    if isinstance(member, cached_property):
        return member.func
    return member.__func__ if isinstance(member, classmethod | staticmethod) else member


def _is_untyped(cls: type, text: str) -> bool:
    """True also if Any or object has another name."""
    names = vars(sys.modules[cls.__module__])
    words = re.findall(r"[A-Za-z_]\w*", text)
    return bool(UNTYPED.search(text)) or any(names.get(word) is Any or names.get(word) is object for word in words)
