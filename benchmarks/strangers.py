"""The command writes tables: python -m benchmarks.strangers [--table FILE] [--remedies FILE] [--choices FILE].

``--table``, ``--remedies`` and ``--choices`` replace tables of a Markdown file (docs/strangers.md): the loops with and
without iterations and relaxation, the effects of advice, the options that campaign() chooses. The figures are topics of
python -m benchmarks.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.lib import campaigns, strangers
from benchmarks.lib.report import replace_table
from verification.strangers import remedies

#: Word of a table, its first column, and the function that makes it.
TABLES = {
    "table": ("problem", strangers.table),
    "remedies": ("failure", remedies.table),
    "choices": ("stranger", campaigns.table),
}


def main() -> None:
    """Run the command line."""
    command = argparse.ArgumentParser("benchmarks.strangers", description=__doc__)
    for word, (column, _) in TABLES.items():
        command.add_argument(
            f"--{word}", metavar="FILE", type=Path, help=f"write the table by {column} of this file anew"
        )
    given = vars(command.parse_args())
    if not any(given.values()):
        command.error(f"expected {', '.join(f'--{word} FILE' for word in TABLES)}")
    for word, (column, make) in TABLES.items():
        if given[word]:
            replace_table(given[word], column, make())


if __name__ == "__main__":
    main()
