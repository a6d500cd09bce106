"""The folder of templates is read here by jinja2, which no other module imports."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import jinja2

from nmpc_codegen.ir.printing.c_style import CStyle


@cache
def template_directory() -> Path:
    """Return the folder of templates: inside the installed package, or at the top of a source checkout."""
    here = Path(__file__).resolve()
    packaged = here.parents[1] / "templates"
    return packaged if packaged.is_dir() else here.parents[3] / "templates"


@cache
def environment() -> jinja2.Environment:
    """Return the jinja2 environment; with StrictUndefined a misspelt name in a template raises an error."""
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(template_directory()),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )


def context(prefix: str, style: CStyle) -> dict[str, Any]:
    """Return names for every template: prefixes, type of the header, and spelling of literals in the unit."""
    return {"p": prefix, "P": prefix.upper(), "real": f"{prefix}_real", "lit": style.literal}
