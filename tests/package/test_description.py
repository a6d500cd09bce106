"""PackageDescription.from_json(), and the comparison of its layout with the compiled code."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from nmpc_codegen import BuildError, export, open_package
from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.description import PackageDescription, Report
from nmpc_codegen.package.opcount import OpCount
from nmpc_codegen.runtime.build import load
from verification import problems

Files = dict[str, str]


def changed(text: str, path: str, value: Any) -> str:
    """The text with one entry replaced: path "rows.0.nodes"."""
    whole = here = json.loads(text)
    *inner, last = [int(word) if word.isdigit() else word for word in path.split(".")]
    for key in inner:
        here = here[key]
    here[last] = value
    return json.dumps(whole)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("sizes", {"NX": 2}, "'N' is missing"),
        ("sizes.NX", "2", r"Expected `int`, got `str` - at `\$\.sizes"),
        ("rows.1.nodes", [1, "x"], r"got `str` - at `\$\.rows\[1\]\.nodes"),
        ("rows.0.lower", "small", "could not convert string to float"),
        ("online.weight", "often", r"Invalid enum value 'often' - at `\$\.online"),
        ("structs.0.fields.0.role", "", "Invalid enum value '' "),
        ("dt", 0.1, r"at `\$\.dt"),
        ("structs", [], "'solver' is missing"),
        ("rows.0.lower", 10**400, "package description"),
        ("format", 6, "format 6, not 11: export it again"),
        ("format", "1", "Expected"),
    ],
)
def test_an_entry_of_a_wrong_type(toy_files: Files, path: str, value: Any, message: str) -> None:
    with pytest.raises(ControllerError, match=message):
        PackageDescription.from_json(changed(toy_files["toy.json"], path, value))


def test_what_is_read_is_what_was_written(toy_files: Files) -> None:
    """Soft penalties, rows at the end and a report, which the small package does not contain."""
    read = PackageDescription.from_json(toy_files["toy.json"])
    rows = tuple(replace(row, name=f"r[{i}]_end", soft=(10.0, 0.5)) for i, row in enumerate(read.rows))
    report = Report(8, {"kkt": 4}, {"linearize": OpCount(add=1, call=2)}, 3, ("qp: none",), ("path_exact",))
    described = replace(read, rows=rows, report=report)
    assert described != read
    assert PackageDescription.from_json(described.to_json()) == described


@pytest.mark.parametrize("text", ["[" * 100_000, '{"format": NaN}', "[]", "null", "{}", "x", ""])
def test_a_text_that_is_no_description(text: str) -> None:
    with pytest.raises(ControllerError, match="package description"):
        PackageDescription.from_json(text)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("name", "joy", "the name is joy in the description, toy"),
        ("precision", "single", "the offset of"),
        ("structs.0.fields.0.shape", [60], "the offset of|the number of bytes"),
        ("structs.0.fields.0.name", "nothing", "lacks what is described.*nothing"),
        ("structs.0.name", "nothing", "lacks what is described|'nothing'"),
        ("structs.0.fields.0.shape", [10**12], "the offset of|lacks what is described"),
        ("sizes.NU", 0, "the size NU is 0 in the description, 1 in the compiled code"),
    ],
)
@pytest.mark.usefixtures("compiler")
def test_a_description_of_other_code(toy_files: Files, path: str, value: Any, message: str) -> None:
    """Before any memory has this layout, however the code was loaded."""
    for profile in ("test", "fast"):
        with pytest.raises(ControllerError, match=message):
            load({**toy_files, "toy.json": changed(toy_files["toy.json"], path, value)}, "toy", profile)


def test_an_edited_description_is_refused(tmp_path: Path) -> None:
    export(problems.tiny(), None, tmp_path)
    path = tmp_path / "tiny.json"
    path.write_text(path.read_text(encoding="utf-8").replace('"NX": 1', '"NX": 2'), encoding="utf-8")
    with pytest.raises(BuildError, match=r"tiny\.json: edited since export\(\) wrote it"):
        open_package(tmp_path)


@pytest.mark.parametrize("path", ["/x.c", "osqp/../../x.c"])
def test_a_file_outside_the_package(toy_files: Files, path: str) -> None:
    with pytest.raises(BuildError, match="outside the package"):
        load({**toy_files, path: ""}, "toy", "test")


def test_a_name_that_is_an_option_of_the_compiler(toy_files: Files) -> None:
    files = {f"-x.{ext}": toy_files[f"toy.{ext}"] for ext in ("h", "c", "json")}
    with pytest.raises(BuildError, match="'-x'; expected a C identifier"):
        load(files, "-x", "test")
