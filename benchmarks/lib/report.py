"""Records of a benchmark: a table for readers and one JSON record per key; a key over several cases is the worst."""

from __future__ import annotations

import json
import math
import platform
import subprocess
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from nmpc_codegen.runtime.build import PROFILES, find_compiler


@dataclass(frozen=True)
class Record:
    """One measured value. ``limit`` is the requirement of the project (None: watched only)."""

    key: str
    case: str
    value: float
    unit: str
    n: int
    limit: float | None
    at_least: bool
    profile: str
    lanes: int


class Report:
    """Collects records, prints them and writes them."""

    def __init__(self, title: str) -> None:
        self.title = title
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
        lanes: int = 1,
    ) -> None:
        """Record a value of a case, based on ``n`` samples."""
        self.records.append(Record(key, case, float(value), unit, n, limit, at_least, profile, lanes))

    def worst(self) -> dict[str, Record]:
        """The worst case of every key; NaN is the worst value."""
        found: dict[str, Record] = {}
        for record in self.records:
            known = found.get(record.key)
            if known is None or _worse(record, known):
                found[record.key] = record
        return found

    def print(self) -> None:
        """Table of all cases, with the verdict if there is a limit."""
        table = Table(title=self.title)
        for column in ("key", "case", "value", "limit", "", "unit", "profile", "n"):
            table.add_column(column, justify="right" if column in ("value", "limit", "n") else "left")
        for r in self.records:
            sign = ">=" if r.at_least else "<="
            limit = f"{sign} {r.limit:g}" if r.limit is not None else ""
            verdict = "" if r.limit is None else ("ok" if meets(r) else "MISS")
            table.add_row(r.key, r.case, f"{r.value:.4g}", limit, verdict, r.unit, r.profile, str(r.n))
        Console(width=140).print(table)
        print(machine())

    def write(self, path: str | Path) -> None:
        """One JSON record per key."""
        out = {
            key: {"value": r.value, "unit": r.unit, "profile": r.profile, "lanes": r.lanes, "n": r.n}
            for key, r in self.worst().items()
        }
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        Path(path).write_text(json.dumps(out, indent=1) + "\n", encoding="utf-8")


def meets(record: Record) -> bool:
    """True if the value satisfies its limit."""
    if record.limit is None:
        return True
    return record.value >= record.limit if record.at_least else record.value <= record.limit


def _worse(a: Record, b: Record) -> bool:
    if math.isnan(b.value):
        return False
    if math.isnan(a.value):
        return True
    return a.value < b.value if a.at_least else a.value > b.value


def machine() -> str:
    """CPU, compiler and flags of the profile "fast"."""
    compiler = find_compiler()
    version = subprocess.run([*compiler, "--version"], capture_output=True, text=True, check=True).stdout
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [
            line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")
        ]
        cpu = names[0] if names else cpu
    return f"{cpu}; {version.splitlines()[0]}; {' '.join(PROFILES['fast'].flags)}"
