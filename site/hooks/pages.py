"""Pages of the site that are files elsewhere in the repository, and links to such files.

README.md is the first page, CHANGELOG.md and CONTRIBUTING.md are pages, and every example is one. A link that leaves
docs/ leads to the page of its file if it has one, else to the file in the repository.
"""

from __future__ import annotations

import ast
import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.plugins import get_plugin_logger
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
LOG = get_plugin_logger("pages")

#: File of the repository -> page of the site.
PAGES = {"README.md": "index.md", "CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md"}

_LINK = re.compile(r"(\]\(|src=\"|^\[[\w-]+\]: )([^)\s\"#]+)((?:#[^)\s\"]*)?)", re.MULTILINE)
_FENCE = re.compile(r"^```(\w+) (?:file|run|theirs)(?:=(\S+))?$", re.MULTILINE)
_FILE = re.compile(r"\[(?:docs/)?([\w-]+)\.md\]\(")  # a link whose text is the name of a page
#: A row of a table, and a span of code in it, in which GitHub needs an escape for | and Python-Markdown none.
_ROW, _SPAN = re.compile(r"^\|.*$", re.MULTILINE), re.compile(r"`[^`]*`")
_CODE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the files that are not in docs/."""
    for source, page in PAGES.items():
        files.append(File.generated(config, page, content=(ROOT / source).read_text(encoding="utf-8")))
    for path in sorted((ROOT / "examples").glob("*.py")):
        files.append(File.generated(config, f"examples/{path.stem}.md", content=page_of_example(path)))
    files.append(File.generated(config, "style.css", abs_src_path=str(ROOT / "site" / "style.css")))
    return files


def page_of_example(path: Path) -> str:
    """An example: what its first sentences say, its picture, its text."""
    text = path.read_text(encoding="utf-8")
    said = ast.get_docstring(ast.parse(text)) or ""
    picture = f"![](../docs/{path.stem}.png)\n\n" if (ROOT / "docs" / f"{path.stem}.png").exists() else ""
    more = "What it adds to the examples before it: [examples](../docs/examples.md).\n\n"
    return f'# {path.name}\n\n{said}\n\n{picture}{more}```python title="examples/{path.name}"\n{text}```\n'


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Titles of blocks that are files, and links as the site has them."""
    source = next((s for s, p in PAGES.items() if p == page.file.src_uri), f"docs/{page.file.src_uri}")
    if page.file.src_uri.startswith("examples/"):
        source = page.file.src_uri

    def lead(found: re.Match[str]) -> str:
        return found[1] + link(found[2], found[3], source, page.file.src_uri, config)

    pieces, end = [], 0
    for block in _CODE.finditer(markdown):
        pieces += [_LINK.sub(lead, markdown[end : block.start()]), _FENCE.sub(_titled, block[0], count=1)]
        end = block.end()
    text = "".join([*pieces, _LINK.sub(lead, markdown[end:])])
    text = _FILE.sub(lambda name: f"[{name[1].replace('-', ' ')}](", text)
    return _ROW.sub(lambda row: _SPAN.sub(lambda span: span[0].replace("\\|", "|"), row[0]), text)


def on_page_content(html: str, page: Page, **_: Any) -> str:
    """Links of a notebook, which is no Markdown."""
    return html if page.file.src_uri.endswith(".md") else re.sub(r'(href="[^":]*)\.md\b', r"\1.html", html)


def _titled(found: re.Match[str]) -> str:
    """The head of a fenced block that is a file of this name."""
    return f'```{found[1]} title="{found[2]}"' if found[2] else f"```{found[1]}"


def link(target: str, anchor: str, source: str, page: str, config: MkDocsConfig) -> str:
    """A link from a file of the repository, as the page of the site needs it."""
    home = str(config.site_url)
    if target.startswith(home):
        path = "docs/" + target.removeprefix(home).replace(".html", ".md")
        path = "README.md" if path == "docs/" else path
    elif "://" in target or target.startswith("mailto:"):
        return target + anchor
    else:
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), target))
    if path.startswith("docs/"):
        inside = path.removeprefix("docs/")
    elif path in PAGES:
        inside = PAGES[path]
    elif re.fullmatch(r"examples/\w+\.py", path):
        inside = path.removesuffix(".py") + ".md"
    else:
        if not (ROOT / path).exists():
            LOG.warning(f"{source}: there is no {target}")
        return f"{config.repo_url}/blob/main/{path}{anchor}"
    return posixpath.relpath(inside, posixpath.dirname(page) or ".") + anchor
