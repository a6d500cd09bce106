"""Checks of the finished site: links and anchors lead somewhere, and every element is one of HTML.

A warning makes `mkdocs build --strict` fail.
"""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.plugins import get_plugin_logger

LOG = get_plugin_logger("links")


class Found(HTMLParser):
    """What a page has: names of places, links, words in angle brackets that HTML does not know."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.places: set[str] = set()
        self.links: list[str] = []
        self.tags: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        given = dict(attributes)
        self.tags.add(tag)
        self.places |= {name for key in ("id", "name") if (name := given.get(key))}
        self.links += [target for key in ("href", "src") if (target := given.get(key))]


def on_post_build(config: MkDocsConfig) -> None:
    """Warn of every dead link of the site."""
    site = Path(config.site_dir)
    pages = {path: Found(path.read_text(encoding="utf-8")) for path in site.rglob("*.html") if path.name != "404.html"}
    for path, page in pages.items():
        name = path.relative_to(site)
        for target in sorted({*page.links}):
            if dead(target, path, pages):
                LOG.warning(f"{name}: {target} leads nowhere")
        for tag in sorted(page.tags - HTML):
            LOG.warning(f"{name}: <{tag}> is no element of HTML; text in angle brackets is lost")


def dead(target: str, path: Path, pages: dict[Path, Found]) -> bool:
    """True if a link inside the site has no file or no place at its end."""
    parts = urlsplit(target)
    if parts.scheme or parts.netloc:
        return False
    file = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    file = file / "index.html" if file.is_dir() else file
    if not parts.fragment or file.suffix != ".html":
        return not file.exists()
    return file not in pages or (unquote(parts.fragment) not in pages[file].places and parts.fragment != "__")


_ELEMENTS = (
    "a abbr article aside audio b blockquote body br button canvas center circle clipboard-copy clippath code col "
    "colgroup dd defs del details dialog div dl dt em figcaption figure footer form g h1 h2 h3 h4 h5 h6 head header hr "
    "html i iframe img input kbd label li line link main mark meta nav object ol option p path pattern picture polygon "
    "polyline pre q rect s samp script section select small source span strong style sub summary sup svg symbol table "
    "tbody td template text textarea tfoot th thead time title tr track tspan u ul use var video wbr"
)
HTML = frozenset(_ELEMENTS.split())
