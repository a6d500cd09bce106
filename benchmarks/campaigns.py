"""Campaigns: python -m benchmarks.campaigns [--scale S] [--json FILE] [--table FILE]

Ten thousand flights of five systems, with their time and losses; a controller that is known to lose, whose worst
flights are replayed; the memory of a million flights. It ends with an exit status of 1 if a figure is beyond its limit.

``--table`` writes what the coach chooses for every stranger in place of the table of a Markdown file.
"""

from __future__ import annotations

from benchmarks.lib import campaigns
from benchmarks.lib.alone import main

if __name__ == "__main__":
    raise SystemExit(main("campaigns", __doc__, "campaigns", table=("stranger", campaigns.table)))
