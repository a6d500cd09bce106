"""Names inside a unit differ from all names of its header.

The header declares <name>_..., where <name> is the user's; names inside the unit are short and the same in every
package. Both can be one word: the package "ny" declares NY_N, the number of its intervals, and NY_N is also the short
name of the number of terminal residuals. The inner name, of a macro, function, variable or member, then ends in "_".
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping

from nmpc_codegen.lowering.dialect.c_expressions import words
from nmpc_codegen.lowering.dialect.scopes import blank

_INNER = re.compile(r"\bAPI\(\w+\)|[A-Za-z_]\w*")

#: Types of <stdint.h> in the header, which do not belong to a package called "int32".
STANDARD = frozenset({"int32_t"})


def renamed_words(inner: Collection[str], header: str, name: str, members: Collection[str] = ()) -> Mapping[str, str]:
    """Return {inner name: new name} for names in ``inner`` that the header of the package ``name`` declares.

    Names of struct members, ``members``, are not renamed.
    """
    prefixes = (f"{name}_", f"{name.upper()}_")
    declared = {w for w in words(blank(header)) if w.startswith(prefixes)} - set(members) - STANDARD
    found: dict[str, str] = {}
    for word in sorted(declared.intersection(inner)):
        new = f"{word}_"
        while new in inner or new in declared:
            new += "_"
        found[word] = new
    return found


def rename(text: str, renamed: Mapping[str, str]) -> str:
    """Return the text with new inner names; API(f), the name of a function of the header, is kept."""
    return _INNER.sub(lambda found: renamed.get(found[0], found[0]), text) if renamed else text
