"""Names inside the translation unit of a package that differ from all names of its header.

The header declares <name>_..., where <name> is the user's; names inside the unit are short and the same in every
package. Both can be one word: the package "ny" declares NY_N, the number of its intervals, and NY_N is also the short
name of the number of terminal residuals. The inner name, of a macro, function, variable or member, then ends in "_".
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import replace

from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.lowering.parts import without_comments

_IDENTIFIER = re.compile(r"[A-Za-z_]\w*")
_INNER = re.compile(r"\bAPI\(\w+\)|[A-Za-z_]\w*")

#: Types of <stdint.h> in the header, which are not the package's even if it is called "int32".
STANDARD = frozenset({"int32_t"})


def names_in(*texts: str) -> set[str]:
    """The identifiers of C texts."""
    return {name for text in texts for name in _IDENTIFIER.findall(text)}


def with_members_apart(module: CModule) -> CModule:
    """The package with an underscore after every member of a struct that would have the name of a size macro."""
    macros = {f"{module.macro}_{macro.name}" for macro in module.macros}
    if not any(member.name in macros for struct in module.structs for member in struct.fields):
        return module
    structs = tuple(
        replace(s, fields=tuple(replace(f, name=f"{f.name}_") if f.name in macros else f for f in s.fields))
        for s in module.structs
    )
    return replace(module, description=replace(module.description, structs=structs))


def renamed_words(words: Collection[str], header: str, name: str, members: Collection[str] = ()) -> Mapping[str, str]:
    """Inner name -> new name, for those of ``words`` that the header of the package ``name`` declares.

    ``members``: words of the header that belong to its structs alone.
    """
    prefixes = (f"{name}_", f"{name.upper()}_")
    declared = {w for w in names_in(without_comments(header)) if w.startswith(prefixes)} - set(members) - STANDARD
    found: dict[str, str] = {}
    for word in sorted(declared.intersection(words)):
        inner = f"{word}_"
        while inner in words or inner in declared:
            inner += "_"
        found[word] = inner
    return found


def rename(text: str, words: Mapping[str, str]) -> str:
    """The text of a unit with new inner names; API(f), the name of a function of the header, stays."""
    return _INNER.sub(lambda found: words.get(found[0], found[0]), text) if words else text
