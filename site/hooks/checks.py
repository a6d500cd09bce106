"""Checks: words in angle brackets are code, links and anchors of the finished site lead somewhere.

A warning makes `mkdocs build --strict` fail.
"""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.plugins import get_plugin_logger
from mkdocs.structure.pages import Page

LOG = get_plugin_logger("checks")
#: Code in any form, and words in angle brackets outside of it, of which pages have pictures alone on purpose.
_CODE = re.compile(r"^```.*?^```$|^ {4,}.*?$|`[^`]+`", re.MULTILINE | re.DOTALL)
_ELEMENT = re.compile(r"</?(?!img\b)([A-Za-z][\w-]*)(?=[\s/>])[^<>]*>")


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Warn of what a browser takes for an element and does not show."""
    for word in _ELEMENT.findall(_CODE.sub("", markdown)):
        LOG.warning(f"{page.file.src_uri}: <{word}> is an element to a browser; expected a span of code")
    return markdown


class Found(HTMLParser):
    """What a page has: names of places, and links."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.places: set[str] = set()
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        given = dict(attributes)
        self.places |= {name for key in ("id", "name") if (name := given.get(key))}
        self.links += [target for key in ("href", "src") if (target := given.get(key))]


def on_post_build(config: MkDocsConfig) -> None:
    """Warn of every dead link of the site."""
    site = Path(config.site_dir)
    paths = (path for path in site.rglob("*.html") if path.name != "404.html")  # its links begin at the site's address
    pages = {path: Found(path.read_text(encoding="utf-8")) for path in paths}
    for path, page in pages.items():
        name = path.relative_to(site)
        for target in sorted({*page.links}):
            if dead(target, path, pages):
                LOG.warning(f"{name}: {target} leads nowhere")


def dead(target: str, path: Path, pages: dict[Path, Found]) -> bool:
    """True if a link inside the site has no file or no place at its end."""
    parts = urlsplit(target)
    if parts.scheme or parts.netloc:
        return False
    file = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    file = file / "index.html" if file.is_dir() else file
    if not parts.fragment or file.suffix != ".html":
        return not file.exists()
    return file not in pages or unquote(parts.fragment) not in pages[file].places
