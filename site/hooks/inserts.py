"""Parts of the reference that programs print: the header of a package, the help of the command, all options, all names.

A page has a comment `insert: name` in their place.
"""

from __future__ import annotations

import contextlib
import inspect
import io
import re
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import casadi as ca
from markdown.extensions.toc import slugify

from nmpc_codegen import OCP, ButcherTableau, Online, Options, Soft, Status, generate
from nmpc_codegen.cli import main

ROOT = Path(__file__).parents[2]
_MARK = re.compile(r"^<!-- insert: (\w+) -->$", re.MULTILINE)
_LINES = re.MULTILINE | re.DOTALL
_CART = re.compile(r"^```python file=cart\.py\n(.*?)^```$", _LINES)
_FUNCTIONS = re.compile(r"^(/\* init: .*?)^/\* end declarations \*/", _LINES)
_EXAMPLE = re.compile(r"^## \[([\w.]+)\]\(.*?\): (.*?)$.*?^!\[(.*?)\]\((.*?)\)$", _LINES)
#: Rooms with public names of their own.
ROOMS = ("", ".campaigns", ".economic", ".derivatives")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Put the parts in their places."""
    return _MARK.sub(lambda mark: INSERTS[mark[1]](), markdown)


def _functions() -> str:
    """The functions of a package with everything that adds one."""
    ocp = OCP("plant", T=1.0, N=10)
    x, u = ocp.state("x"), ocp.control("u")
    z, m = ocp.algebraic("z"), ocp.parameter("m", value=1.0)
    ocp.dynamics({x: (z + 0.1 * ocp.rate(u)) / m + 0 * ocp.time})
    ocp.algebraic_equation(z + z**3 - u)
    ocp.least_squares(ca.vertcat(x, u), weight=1.0)
    ocp.terminal_least_squares(x, weight=1.0)
    ocp.subject_to(-1, x, 1, soft=Soft(lower=1e3, upper=1e3))
    options = Options(online=Online("node", "node", "node", "node", soft="node"))
    (text,) = _FUNCTIONS.findall(generate(ocp, options)["plant.h"])
    return f"```c\n{text.rstrip()}\n```"


def _header() -> str:
    """The header of the cart."""
    found: dict[str, Any] = {}
    (text,) = _CART.findall((ROOT / "docs" / "start.md").read_text(encoding="utf-8"))
    exec(text, found)
    return f'```c title="cart.h"\n{generate(found["ocp"])["cart.h"].rstrip()}\n```'


def _statuses() -> str:
    """Value, name and meaning of every status."""
    rows = [f"| {status.value} | `{status.name}` | {status.meaning} |" for status in Status]
    return "\n".join(["| value | `<NAME>_` | |", "|---|---|---|", *rows])


def _printed(*arguments: str) -> str:
    """What nmpc-export prints."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
        main(list(arguments))
    return f"```text\n{said.getvalue().rstrip()}\n```"


def _names() -> str:
    """Every public name with its first sentence."""
    rows = ["| name | |", "|---|---|"]
    for room in ROOMS:
        module = import_module(f"nmpc_codegen{room}")
        for name in sorted(module.__all__, key=str.lower):
            link = f"[`{(room + '.' + name).lstrip('.')}`][nmpc_codegen{room}.{name}]"
            rows.append(f"| {link} | {_first(getattr(module, name))} |")
    return "\n".join(rows)


def _first(found: Any) -> str:
    """The first sentence of what help() says of a class or function; what a constant is."""
    if isinstance(found, ButcherTableau):
        return f"Scheme of order {found.order}, {found.kind}"
    if not callable(found):
        return ", ".join(f"`{word}`" for word in found)
    text = (inspect.getdoc(found) or "").partition("\n\n")[0].replace("\n", " ")
    sentence = re.match(r".*?[.:](?= [A-Z]|$)|.*", text)
    return (sentence[0] if sentence else text).rstrip(".:").replace("|", "\\|").replace("<", "&lt;")


def _gallery() -> str:
    """A picture of every example, which leads to its section."""
    page = (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")
    cards = []
    for file, what, alt, picture in _EXAMPLE.findall(page):
        place = slugify(f"{file}: {what}", "-")
        said = f"<b>{file}</b><span>{what}</span>"
        cards.append(f'<a href="#{place}"><img src="{picture}" alt="{alt}" loading="lazy">{said}</a>')
    return '<div class="gallery">\n' + "\n".join(cards) + "\n</div>"


INSERTS: dict[str, Callable[[], str]] = {
    "functions": _functions,
    "gallery": _gallery,
    "header": _header,
    "help": lambda: _printed("--help"),
    "names": _names,
    "options": lambda: _printed("--list-options"),
    "statuses": _statuses,
}
