"""PackageDescription.from_json() and the comparison in compiled.py: an error names the wrong entry."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmarks.lib.doors import doors_trust, mutated_package
from nmpc_codegen.errors import BuildError, ControllerError
from nmpc_codegen.runtime.build import load
from nmpc_codegen.runtime.package_description import OpCount, PackageDescription, Report
from nmpc_codegen.runtime.parse import MAX_CHARACTERS

TOY = Path(__file__).parents[1] / "data" / "toy"
Files = dict[str, str]


def changed(text: str, path: str, value: Any) -> str:
    """The text with one entry replaced: path "rows.0.nodes"."""
    whole = here = json.loads(text)
    *inner, last = [int(word) if word.isdigit() else word for word in path.split(".")]
    for key in inner:
        here = here[key]
    here[last] = value
    return json.dumps(whole)


MEMBER = {"name": "a", "type": "loop", "shape": [], "padded": [], "role": "", "doc": ""}


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("sizes.NU", True, r"sizes\.NU is True; expected an integer"),
        ("sizes.NU", -1, r"sizes\.NU is -1; expected an integer in 0\.\."),
        ("sizes.N", 0, r"sizes\.N is 0"),
        ("sizes.NX", 2**31, r"sizes\.NX is 2147483648"),
        ("sizes.NX", "2", r"sizes\.NX is '2'"),
        ("sizes.NY", None, r"sizes\.NY is None"),
        ("sizes.NY", 4, r"y_names is .*expected 4 entries, not 3"),
        ("sizes.NR", 60, r"rows is .*expected 60 entries"),
        ("name", "a b", "name is 'a b'; expected a C identifier"),
        ("extra", 1, "'extra' is an entry that this version does not know"),
        ("dt.0", 0, r"dt\[0\] is 0.*positive"),
        ("dt.0", 10**400, r"dt\[0\] is .*finite"),
        ("discrete", 0, "discrete is 0; expected true or false"),
        ("options", "\ud800", "options is .*Unicode"),
        ("report", [], "report is .*an object"),
        ("report", {"ram_bytes": -1}, r"report\.ram_bytes is -1; expected an integer"),
        ("report", {"choices": "qp"}, r"report\.choices is 'qp'; expected a list"),
        ("report", {"operations": {"kkt": {"add": 1}}}, r"report\.operations\.kkt\.mul is missing"),
        ("report", {"speed": 1}, r"report\.'speed' is an entry that this version does not know"),
        ("structs.0.fields.0.role", "", r"fields\[0\]\.role is ''; expected one of setting, data"),
        ("online.weight", "often", r"online\.weight is 'often'; expected one of fixed, shared, node"),
        ("states.1.offset", 0, r"states\[1\]\.offset is 0; expected 1"),
        ("states.1.name", "p", r"states\[1\]\.name is 'p'"),
        ("parameters.1.size", 3, r"parameters\[1\]\.value is .*expected 3 entries"),
        ("parameters.1.scalar", True, r"parameters\[1\]\.size is 2; expected 1"),
        ("parameters.0.value", ["1"], r"parameters\[0\]\.value\[0\] is '1'; expected a number"),
        ("rows.0.index", 1, r"rows\[0\]\.index is 1; expected an integer in 0\.\.0"),
        ("rows.0.nodes", [], r"rows\[0\]\.nodes is \[\]"),
        ("rows.1.nodes", [1, 5], r"rows\[1\]\.nodes\[1\] is 5"),
        ("rows.1.nodes", [2, 1], r"rows\[1\]\.nodes is \[2, 1\]; expected .*ascending"),
        ("rows.0.lower", 6, r"rows\[0\]\.lower is 6; expected at most"),
        ("rows.0.name", "a[0]_middle", r"expected a name like v or r\[0\]"),
        ("rows.0.name", "a[", r"rows\[0\]\.name is 'a\['"),
        ("rows.1.name", "a", "rows of different names"),
        ("structs.3.name", "solve", "a struct solver among them"),
        ("structs.1.name", "real", r"structs\[1\]\.name is 'real'"),
        ("structs.0", {"name": "loop", "doc": "", "fields": [MEMBER]}, r"structs\[0\]\.fields\[0\]\.type is 'loop'"),
        ("structs.0.fields.0.padded", [4, 3], r"padded is \[4, 3\]; expected the shape"),
        ("structs.0.fields.0.shape", [10**12, 2], r"shape\[0\] is 1000000000000"),
    ],
)
def test_an_entry_that_is_wrong(toy_files: Files, path: str, value: Any, message: str) -> None:
    with pytest.raises(ControllerError, match=message):
        PackageDescription.from_json(changed(toy_files["toy.json"], path, value))


def test_what_is_read_is_what_was_written(toy_files: Files) -> None:
    """Soft penalties, rows at the end and a report, which the hand-written toy.json does not contain."""
    read = PackageDescription.from_json(toy_files["toy.json"])
    rows = tuple(replace(row, name=f"r[{i}]_end", soft=(10.0, 0.5)) for i, row in enumerate(read.rows))
    report = Report(
        8, {"kkt": 4}, {"linearize": OpCount(add=1, call=2)}, 3, {"sample": 9}, ("qp: none",), ("path_exact",)
    )
    described = replace(read, rows=rows, report=report)
    assert described != read
    assert PackageDescription.from_json(described.to_json()) == described


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "too deeply nested"),
        ('{"format": 1, "format": 1}', "'format' occurs twice"),
        ('{"format": NaN}', "NaN is no number"),
        ('{"format": ' + "9" * 5000 + "}", "integer string conversion"),
        ('{"format": 1.0}', "format 1.0, this version reads 1"),
        ("[]", "not the JSON that export"),
        ("null", "not the JSON that export"),
        (" " * (MAX_CHARACTERS + 1), "characters; expected at most"),
    ],
    ids=["deep", "twice", "NaN", "digits", "float", "list", "null", "long"],
)
def test_a_text_that_is_no_description(text: str, message: str) -> None:
    with pytest.raises(ControllerError, match=message):
        PackageDescription.from_json(text)


# -- what agrees with itself, but not with the compiled code -----------------------------------------------------------


def consistent(raw: dict[str, Any], case: str) -> None:
    """Wrong entries that from_json() cannot detect."""
    members = {f["name"]: f for f in raw["structs"][-1]["fields"]}
    match case:
        case "sizes":
            raw["sizes"]["NU"] = 2
            raw["controls"][0] |= {"size": 2, "scalar": False, "value": [0.0, 0.0]}
        case "parameters":
            raw["parameters"][0] |= {"size": 2, "scalar": False, "value": [0.0, 0.0]}
            raw["parameters"][1] |= {"size": 1, "offset": 2, "value": [0.0]}
        case "order":
            raw["rows"][1]["name"], raw["rows"][2]["name"] = raw["rows"][2]["name"], raw["rows"][1]["name"]
        case "layout":
            raw["online"]["weight"] = "node"
        case "fixed":
            raw["online"]["bounds"] = "fixed"
        case "precision":
            raw["precision"] = "single"
        case "shape":
            members["mu"] |= {"shape": [4, 1]}
        case "name":
            raw["name"] = "joy"


@pytest.mark.parametrize(
    ("case", "message"),
    [
        ("sizes", "the size NU is 2 in the description, 1 in the compiled code"),
        ("parameters", "the size of the parameter 'm' is 2 in the description, 1 in the compiled code"),
        ("order", r"the number of the row 'box\[1\]' is 1 in the description, 2"),
        ("layout", r"the member W of the solver is real \[1, 3\] .*expected real \[4, 3\]"),
        ("fixed", "the member lower of the solver is .*expected none"),
        ("precision", "the type of real numbers is float in the description, double"),
        ("shape", r"the member mu of the solver is real \[4, 1\] .*expected real \[4, 0\] or none"),
        ("name", "the description is that of 'joy'"),
    ],
)
@pytest.mark.usefixtures("compiler")
def test_a_description_of_other_code(toy_files: Files, case: str, message: str) -> None:
    raw = json.loads(toy_files["toy.json"])
    consistent(raw, case)
    with pytest.raises(ControllerError, match=message):
        load({**toy_files, "toy.json": json.dumps(raw)}, "toy", "test")


@pytest.mark.parametrize("path", ["/x.c", "osqp/../../x.c"])
def test_a_file_outside_the_package(toy_files: Files, path: str) -> None:
    with pytest.raises(BuildError, match="outside the package"):
        load({**toy_files, path: ""}, "toy", "test")


def test_a_name_that_is_an_option_of_the_compiler(toy_files: Files) -> None:
    files = {f"-x.{ext}": toy_files[f"toy.{ext}"] for ext in ("h", "c", "json")}
    with pytest.raises(BuildError, match="'-x'; expected a C identifier"):
        load(files, "-x", "test")


# -- mutations ---------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("compiler")
def test_mutations_are_refused_or_harmless(toy_files: Files, tmp_path: Path) -> None:
    for path, text in toy_files.items():
        (tmp_path / path).write_text(text, encoding="utf-8")
    outcomes = {}
    for k in range(1000, 1120):
        label, text = mutated_package.mutate(toy_files["toy.json"], k)
        outcomes[f"{k}: {label}"] = mutated_package.outcome(tmp_path, "toy", text, "test")
    assert {case: found for case, found in outcomes.items() if found not in ("refused", "opened")} == {}
    assert sum(found == "refused" for found in outcomes.values()) > 80


@pytest.mark.slow
@pytest.mark.usefixtures("compiler")
def test_mutations_under_the_address_sanitizer() -> None:
    library = doors_trust.sanitizer()
    if not library:
        pytest.skip("the compiler has no AddressSanitizer")
    lines, crashes = doors_trust.campaign(TOY, 40, library)
    assert not crashes
    assert not [line for line in lines if " wrong" in line]
    assert len(lines) == 40
