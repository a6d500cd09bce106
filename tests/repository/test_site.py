"""The site: it builds without a warning, its reference has everything public, its pages fit a telephone."""

from __future__ import annotations

import doctest
import enum
import functools
import html
import http.server
import importlib
import inspect
import json
import re
import shutil
import subprocess
import sys
import threading
import types
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import griffe
import pytest
from conftest import require_tool

from tests.snippets import ROOT, blocks, entries

#: Rooms with public names of their own.
ROOMS = ("nmpc_codegen", "nmpc_codegen.campaigns", "nmpc_codegen.economic", "nmpc_codegen.derivatives")
#: Classes of the reference that have no name there: what public functions return.
RETURNED = ("runtime.solving.Solution", "package.status.Kkt", "package.status.Stats", "runtime.records.trace.Plans")

WIDTH = 390  # of a telephone, in pixels
CHROMIUM = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--disable-dev-shm-usage", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--dump-dom"),
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE localhost",
)
#: One page after the other in a frame of this width; each writes how wide it is.
LOOK = """<!doctype html><body><pre id="found"></pre><script>
const pages = PAGES, found = {};
function look(k) {
  if (k == pages.length) { document.getElementById("found").textContent = JSON.stringify(found); return; }
  const frame = document.createElement("iframe");
  frame.style.width = "WIDTHpx";
  frame.onload = () => {
    found[pages[k]] = frame.contentDocument.documentElement.scrollWidth; look(k + 1); frame.remove();
  };
  frame.src = pages[k];
  document.body.append(frame);
}
look(0);
</script></body>"""


#: How the Makefile calls it.
(OPTIONS,) = re.findall(r"mkdocs build (.*) -f", (ROOT / "Makefile").read_text(encoding="utf-8"))


def build(configuration: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """mkdocs build, as `make docs` does it."""
    command = [sys.executable, "-m", "mkdocs", "build", *OPTIONS.split(), "-f", str(configuration), "-d", str(folder)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The finished site."""
    folder = tmp_path_factory.mktemp("site")
    done = build(ROOT / "site" / "mkdocs.yml", folder)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[there](other.html)", "other.html leads nowhere"),
        ("[here](#nowhere)", "#nowhere leads nowhere"),
        ("![a picture](missing.png)", "missing.png leads nowhere"),
        ("the function <name>_step", "<name> is an element to a browser"),
        ("the file <path>", "<path> is an element to a browser"),
        ("the function `<name>_step`", ""),
        ("[here](#page)", ""),
    ],
)
def test_dead_links_stop_the_build(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text(f"# Page\n\n{text}\n", encoding="utf-8")
    hook = ROOT / "site" / "hooks" / "checks.py"
    (tmp_path / "mkdocs.yml").write_text(f"site_name: a\nhooks: [{hook}]\n", encoding="utf-8")
    done = build(tmp_path / "mkdocs.yml", tmp_path / "out")
    assert (done.returncode == 0) == (said == ""), done.stderr
    assert said in done.stderr


# The reference -------------------------------------------------------------------------------------------------------


def test_the_reference_has_every_public_name(site: Path) -> None:
    """dir() of every room with public names, and what their functions return."""
    packed = (site / "objects.inv").read_bytes().split(b"\n", 4)[4]
    listed = {line.split(" ")[0] for line in zlib.decompress(packed).decode().splitlines()}
    for room in ROOMS:
        module = importlib.import_module(room)
        names = dir(module) if room == "nmpc_codegen" else module.__all__
        assert not [name for name in names if not name.startswith("__") and f"{room}.{name}" not in listed]
    assert not [name for name in RETURNED if f"nmpc_codegen.{name}" not in listed]


def test_the_reference_is_searched(site: Path) -> None:
    found = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))["docs"]
    places = {entry["location"] for entry in found}
    assert {"reference/problem.html#nmpc_codegen.OCP.subject_to", "tutorial.html#on-the-board"} <= places


@functools.cache
def package() -> Any:
    """The package as its text states it."""
    return griffe.load(
        "nmpc_codegen", search_paths=[str(ROOT / "src")], resolve_aliases=True, docstring_parser="google"
    )


def public() -> list[Any]:
    """Classes and functions with public names, and what these return, each once."""
    names = [f"{room}.{name}" for room in ROOMS for name in importlib.import_module(room).__all__]
    names += [f"nmpc_codegen.{name}" for name in RETURNED]
    found = [package()[name.removeprefix("nmpc_codegen.")] for name in names]
    assert not [f.path for f in found if f.is_module], "a module has the name of a function"
    final = {f.path: f for f in (f.final_target if f.is_alias else f for f in found)}
    return [f for _, f in sorted(final.items()) if f.is_class or f.is_function]


def stated(cls: Any) -> set[str]:
    """Names that the sections of a class and its bases explain."""
    return set().union(*(entries(c.docstring.value, "Args|Attributes") for c in (cls, *cls.mro()) if c.docstring))


def is_of_components(cls: Any, member: Any) -> bool:
    """True for what is not an option of a component: it is for whoever writes one."""
    return "seam" in cls.all_members and not {"instance-attribute"} & member.labels


def members(cls: Any) -> Iterator[tuple[str, Any]]:
    """Public members that are meant for users."""
    for name, found in cls.all_members.items():
        member = found.final_target if found.is_alias else found
        internal = member.docstring is not None and "(internal)." in member.docstring.value.partition("\n")[0]
        constant = member.labels & {"class-attribute", "instance-attribute", "property"} == {"class-attribute"}
        if not (name.startswith("_") or internal or constant or is_of_components(cls, member)):
            yield name, member


def unexplained(function: Any) -> list[str]:
    """Parameters that the docstring of a function does not mention."""
    text = function.docstring.value if function.docstring else ""
    text = text.partition("Args:\n")[2] or text
    names = [p.name for p in function.parameters if p.name not in ("self", "cls")]
    return [name for name in names if not re.search(rf"\b{re.escape(name)}\b", text)]


@pytest.mark.parametrize("found", public(), ids=lambda f: f.path.removeprefix("nmpc_codegen."))
def test_every_member_is_explained(found: Any) -> None:
    """A docstring, or an entry of the class's; every parameter is mentioned."""
    assert found.docstring
    if found.is_function:
        assert unexplained(found) == []
        return
    module = importlib.import_module(found.module.path)
    cls = functools.reduce(getattr, found.path.removeprefix(f"{module.__name__}.").split("."), module)
    words = {word.name for word in cls} if issubclass(cls, enum.Enum) else set()
    explained = stated(found) | words
    bare = [name for name, member in members(found) if not member.docstring and name not in explained]
    assert bare == []
    texts = "".join(inspect.getsource(base) for base in cls.__mro__ if base.__module__.startswith("nmpc_codegen"))
    assert [n for n in entries(found.docstring.value, "Attributes") if not re.search(rf"\b{n}\b(: |,| =)", texts)] == []
    assert not {n: m for n, member in members(found) if member.is_function and (m := unexplained(member))}


def modules() -> list[types.ModuleType]:
    """Modules with an example in a docstring."""
    found = [
        p for p in sorted((ROOT / "src" / "nmpc_codegen").rglob("*.py")) if ">>> " in p.read_text(encoding="utf-8")
    ]
    places = [p.relative_to(ROOT / "src").with_suffix("").as_posix().replace("/", ".") for p in found]
    return [importlib.import_module(place.removesuffix(".__init__")) for place in places]


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("module", modules(), ids=lambda m: m.__name__.removeprefix("nmpc_codegen."))
def test_examples_of_docstrings(module: types.ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They know what the page of the reference states, and write into a folder of their own."""
    monkeypatch.chdir(tmp_path)
    known: dict[str, Any] = {"inf": float("inf")}
    for block in blocks("docs/reference/index.md"):
        exec(block.text, known)
    result = doctest.testmod(module, extraglobs=known)
    assert result.attempted > 0
    assert result.failed == 0


# Pages ---------------------------------------------------------------------------------------------------------------


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        """Say nothing."""


@pytest.fixture
def address(site: Path) -> Iterator[str]:
    """Where the site is served."""
    server = http.server.ThreadingHTTPServer(("localhost", 0), functools.partial(Quiet, directory=str(site)))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://localhost:{server.server_port}"
    server.shutdown()
    thread.join()


#: Marks of Markdown that no renderer has read: lists without an empty line, tables, links, code, bold text.
LEFT_OVER = re.compile(r"\n\s*(?:- |\d+\. )|^\|.*\|$|\]\(|`|\*\*(?!\w)", re.MULTILINE)


def test_no_markdown_is_left_over(site: Path) -> None:
    """What GitHub reads and Python-Markdown does not."""
    found = []
    for path in site.rglob("*.html"):
        (article,) = re.findall(r"<article.*?</article>", path.read_text(encoding="utf-8"), re.DOTALL) or [""]
        bare = re.sub(r"<(pre|code|script|style)\b.*?</\1>", "", article, flags=re.DOTALL)
        texts = re.findall(r"<(p|li|td|h\d)\b[^>]*>(.*?)</\1>", bare, re.DOTALL)
        plain = [html.unescape(re.sub(r"<[^>]+>", "", text)) for _, text in texts]
        found += [(path.name, text) for text in plain if LEFT_OVER.search(text)]
    assert found == []


def test_pages_fit_a_telephone(site: Path, address: str, tmp_path: Path) -> None:
    """No page is wider than its window, as Chromium draws it; a page that is too wide is seen."""
    chromium = require_tool("chromium")
    pages = [str(p.relative_to(site)) for p in sorted(site.rglob("*.html")) if p.parent.name != "examples"]
    (site / "wide.html").write_text(f'<div style="width: {2 * WIDTH}px">wide</div>', encoding="utf-8")
    text = LOOK.replace("PAGES", json.dumps([*pages, "wide.html"])).replace("WIDTH", str(WIDTH))
    (site / "look.html").write_text(text, encoding="utf-8")
    command = [chromium, *CHROMIUM, f"--user-data-dir={tmp_path}", f"{address}/look.html"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    (said,) = re.findall(r'<pre id="found">(.*?)</pre>', done.stdout)
    widths = json.loads(said)
    assert len(widths) == len(pages) + 1
    assert widths.pop("wide.html") >= 2 * WIDTH
    assert {page: width for page, width in widths.items() if width > WIDTH} == {}
    shutil.rmtree(tmp_path, ignore_errors=True)
