"""C text with one statement in a line, as parts are written."""

from __future__ import annotations

import re


def in_lines(text: str) -> str:
    """Break lines behind braces and semicolons outside of parentheses; a function begins and ends a line."""
    depth, found = 0, []
    for token in re.findall(r"/\*.*?\*/|[(){};]|[^(){};/]+|/", text, re.DOTALL):
        depth += (token == "(") - (token == ")")
        breaks = depth == 0 and token in "{};"
        before = "\n" if depth == 0 and (token == "}" or token.startswith("/*")) else ""
        found.append(before + token + ("\n" if breaks or token.startswith("/*") else ""))
    lines = [line.strip() for line in "".join(found).split("\n") if line.strip()]
    level, indented = 0, []
    for line in lines:
        level -= line.startswith("}")
        indented.append("    " * level + line)
        level += line.endswith("{")
    joined = re.sub(r"\}\n *else", "} else", "\n".join(indented))
    return re.sub(r"(?m)^(static [^\n;{]*\)) ?\{$", r"\1\n{", joined) + "\n"
