"""A campaign in a process of its own, which tests kill: python -m tests.campaigns.flying FOLDER FLIGHTS [WORKERS]."""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor

from nmpc_codegen.campaigns import campaign
from nmpc_codegen.campaigns.flying import work
from tests.campaigns.problems import cart


def main(folder: str, flights: int, workers: int) -> None:
    """Fly in small parts."""
    work.MOST, work.FIRST = 20, 20
    executor = ProcessPoolExecutor(workers) if workers else None
    campaign(cart(), flights, noise=0.01, steps=400, folder=folder, executor=executor, progress=False)
    print("done", flush=True)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else 0)
