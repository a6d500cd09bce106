"""Options are spelled as a line of Python to paste."""

from __future__ import annotations

from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Any

from nmpc_codegen.components.integrators import ButcherTableau


def spell_options(value: Any) -> str:
    """Return options, or a part of them, as Python; fields with default values are left out."""
    if isinstance(value, ButcherTableau):
        return value.name
    if not is_dataclass(value) or isinstance(value, type):
        return repr(value)
    words = []
    for field in fields(value):
        own = getattr(value, field.name)
        if field.init and not _is_default(field, own):
            bare = isinstance(own, ButcherTableau)
            words.append(spell_options(own) if bare else f"{field.name}={spell_options(own)}")
    return f"{type(value).__name__}({', '.join(words)})"


def _is_default(field: Field[Any], value: Any) -> bool:
    known = field.default if field.default_factory is MISSING else field.default_factory()
    return bool(known is not MISSING and value == known)
