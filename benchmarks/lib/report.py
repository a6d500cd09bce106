"""Records of the benchmarks become a page for readers, with the baseline beside every figure, and JSON."""

from __future__ import annotations

import json
import math
import platform
import re
import subprocess
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from nmpc_codegen.runtime.build import PROFILES
from nmpc_codegen.runtime.compilers import find_compiler
from nmpc_codegen.targets import PORTABLE

#: Growth from which a figure of this unit is marked, relative to its baseline; times only if they are comparable.
GROWN = {"us": 1.10, "B": 1.02, "instructions": 1.02, "operations": 1.02}
MARK, MISS = "[bold red]▲[/]", "[bold red]miss[/]"
WIDTH = 150


@dataclass(frozen=True)
class Record:
    """A record is one measured value. ``limit`` is the requirement of the project (None: watched only)."""

    topic: str
    key: str
    case: str
    value: float
    unit: str
    n: int
    limit: float | None
    at_least: bool
    profile: str
    target: str

    @property
    def place(self) -> str:
        """Return the key of the value: topic, case and key."""
        return f"{self.topic}/{self.case}/{self.key}"

    def meets(self) -> bool:
        """Return True if the value satisfies its limit or has none."""
        if self.limit is None:
            return True
        return self.value >= self.limit if self.at_least else self.value <= self.limit


@dataclass(frozen=True)
class Baseline:
    """A baseline has figures by their key, and the keys of times.

    ``same_machine``: its times are comparable with those of this run.
    """

    label: str
    values: dict[str, float]
    times: frozenset[str]
    same_machine: bool

    @classmethod
    def of(cls, path: Path, label: str, same_machine: bool | None = None) -> Baseline:
        """Read a file that Report.write() wrote."""
        found = json.loads(path.read_text(encoding="utf-8"))
        places = {f"{r['topic']}/{r['case']}/{r['key']}": r for r in found["records"]}
        values = {place: r["value"] for place, r in places.items()}
        times = frozenset(place for place, r in places.items() if r["unit"] == "us")
        return cls(label, values, times, found["machine"] == machine() if same_machine is None else same_machine)

    @classmethod
    def empty(cls, label: str) -> Baseline:
        """Return a baseline without figures, which take() adds."""
        return cls(label, {}, frozenset(), same_machine=True)

    def take(self, records: Iterable[Record]) -> None:
        """Add figures that were measured in turn with those of this run."""
        self.values.update({record.place: record.value for record in records})

    def carry(self, factor: float) -> None:
        """Multiply the times of another machine, whose reference kernel takes 1 / ``factor`` of the time of ours."""
        if not self.same_machine:
            self.values.update({place: factor * self.values[place] for place in self.times})

    def grew(self, record: Record) -> bool:
        """Return True if bytes, instructions and operations are 2 % above the baseline, or times 10 %."""
        known, slack = self.values.get(record.place), GROWN.get(record.unit)
        if known is None or slack is None or (record.unit == "us" and not self.same_machine):
            return False
        return record.value > slack * known


class Report:
    """A report collects records, prints them topic by topic and writes them."""

    def __init__(self, baseline: Baseline | None = None) -> None:
        self.topic = ""
        self.baseline = baseline or Baseline.empty("none")
        self.records: list[Record] = []

    def add(
        self,
        key: str,
        value: float,
        unit: str = "",
        *,
        case: str = "",
        n: int = 1,
        limit: float | None = None,
        at_least: bool = False,
        profile: str = "fast",
        target: str = PORTABLE.name,
    ) -> None:
        """Record a value of a case, based on ``n`` samples."""
        record = Record(self.topic, key, case, float(value), unit, n, limit, at_least, profile, target)
        self.records.append(record)

    def of(self, topic: str) -> list[Record]:
        """Return the records of a topic."""
        return [record for record in self.records if record.topic == topic]

    def print_matrix(self, topic: str) -> None:
        """Print a line per case and a column per key; every value is followed by the baseline in parentheses."""
        records = {(r.case, r.key): r for r in self.of(topic)}
        units = {r.key: r.unit for r in records.values()}
        table = Table(title=topic, title_justify="left", box=box.SIMPLE_HEAD)
        table.add_column("", no_wrap=True)
        for key, unit in units.items():
            table.add_column(f"{key}\n{unit}", justify="right")
        for case in dict.fromkeys(case for case, _ in records):
            row = (records.get((case, key)) for key in units)
            table.add_row(case, *("" if r is None else self._cell(r) for r in row))
        _show(table)

    def print_list(self, topic: str) -> None:
        """Print a line per record, for topics whose cases have few keys in common."""
        table = Table(title=topic, title_justify="left", box=box.SIMPLE_HEAD)
        for column in ("key", "case", "value (baseline)", "limit", "unit", "n"):
            table.add_column(column, justify="left" if column in ("key", "case", "unit") else "right")
        for r in self.of(topic):
            sign = ">=" if r.at_least else "<="
            limit = f"{sign} {r.limit:g}" if r.limit is not None else ""
            table.add_row(r.key, r.case, self._cell(r), limit, r.unit, str(r.n))
        _show(table)

    def _cell(self, record: Record) -> str:
        known = self.baseline.values.get(record.place)
        cell = number(record.value) + ("" if known is None else f" ({number(known)})")
        mark = "" if record.meets() else f"{MISS} "
        return f"{mark}{MARK} {cell}" if self.baseline.grew(record) else f"{mark}{cell}"

    def grown(self) -> list[Record]:
        """Return the figures that grew beyond the slack of their unit."""
        return [record for record in self.records if self.baseline.grew(record)]

    def missed(self) -> list[Record]:
        """Return the figures beyond their limit."""
        return [record for record in self.records if not record.meets()]

    def write(self, path: str | Path, **about: object) -> None:
        """Write all records with the description ``about`` of the run."""
        head = json.dumps({"machine": machine(), **about}, indent=1).removesuffix("\n}")
        lines = ",\n  ".join(json.dumps(asdict(record)) for record in self.records)
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        Path(path).write_text(f'{head},\n "records": [\n  {lines}\n ]\n}}\n', encoding="utf-8")


def _show(table: Table) -> None:
    Console(width=WIDTH).print(table)


def number(value: float) -> str:
    """Return three digits; from a thousand to a million million, and for integers, no decimals."""
    if not math.isfinite(value) or abs(value) >= 1e12:
        return f"{value:.3g}"
    return f"{value:,.0f}" if value == round(value) or abs(value) >= 1e3 else f"{value:.3g}"


def replace_table(path: Path, column: str, table: str) -> None:
    """Replace the table of a Markdown file whose first column has this name."""
    text = path.read_text(encoding="utf-8")
    path.write_text(re.sub(rf"(?m)^\| {column} \|.*\n(^\|.*\n)*", lambda _: table, text, count=1), "utf-8")


def listed(records: Iterable[Record]) -> str:
    """Return one line per record: its key and value."""
    return "\n".join(f"  {r.place}: {number(r.value)} {r.unit}".rstrip() for r in records)


def machine() -> str:
    """Return CPU, compiler and flags of the profile "fast"."""
    compiler = find_compiler()
    version = subprocess.run([*compiler, "--version"], capture_output=True, text=True, check=True).stdout
    cpu, info = platform.processor() or platform.machine(), Path("/proc/cpuinfo")
    if info.exists():
        lines = info.read_text().splitlines()
        fields = dict(line.partition(":")[::2] for line in reversed(lines) if ":" in line)
        known = {name.strip(): value.strip() for name, value in fields.items()}
        cpu = f"{known.get('model name', cpu)} (model {known.get('model', '?')})"
    return f"{cpu}; {version.splitlines()[0]}; {' '.join(PROFILES['fast'].flags)}"
