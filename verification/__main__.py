"""The command prints the table of contracts, or writes the file of the components of samples.

python -m verification --table    of every component the samples that each contract holds: in `make test`, and in all
python -m verification --write    verification/contracts/components.json, after a change of samples or of defaults
"""

from __future__ import annotations

import argparse
import json

from verification.contracts.contract import CONTRACTS, FILE, HELD, chosen_by_the_compiler, table


def print_table() -> None:
    """Print contracts by components, with the reasons of cells without samples below."""
    titles, lines, reasons = table()
    width = max(len(line[0]) for line in lines)
    print("samples held to contracts: in `make test` / in `make test-all`")
    for line in (titles, *lines):
        print(f"{line[0]:{width}}", *(f"{cell:>6}" for cell in line[1:]))
    for number, contract in enumerate(CONTRACTS, 1):
        first = (contract.hold.__doc__ or "").strip().split("\n\n")[0]
        print(f"{number:2}  {contract.name}: {' '.join(first.split())}")
    for why, mark in reasons.items():
        print(f" {mark}  {why}")


def write() -> None:
    """Write the components of every sample, as the compiler chooses them."""
    entries = (f"  {json.dumps(sample.name)}: {json.dumps(chosen_by_the_compiler(sample))}" for sample in HELD)
    FILE.write_text("{\n" + ",\n".join(entries) + "\n}\n", encoding="utf-8")


def main() -> None:
    """Print the table or write the file, as the command line says."""
    parser = argparse.ArgumentParser(prog="python -m verification", description=__doc__.split("\n")[0])
    parser.add_argument("--table", action="store_true", help="print contracts by components")
    parser.add_argument("--write", action="store_true", help="write the components of the samples anew")
    asked = parser.parse_args()
    if not (asked.table or asked.write):
        parser.error("expected --table or --write")
    if asked.write:
        write()
    if asked.table:
        print_table()


if __name__ == "__main__":
    main()
