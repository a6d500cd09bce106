"""Findings of cppcheck's MISRA C:2012 addon, by rule."""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

_FINDING = re.compile(r"^misra-c2012-(\d+\.\d+) ", re.MULTILINE)


def findings(sources: Mapping[str, str], name: str) -> Counter[str] | None:
    """Rule -> number of findings in a package; None if cppcheck has no such addon."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for ext in ("h", "c"):
            (folder / f"{name}.{ext}").write_text(sources[f"{name}.{ext}"], encoding="utf-8")
        command = ["cppcheck", "--addon=misra", "--std=c99", "--quiet", "--template={id} {line}", f"{name}.c"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0 or "addon" in done.stderr.lower():
        return None
    return Counter(_FINDING.findall(done.stderr))
