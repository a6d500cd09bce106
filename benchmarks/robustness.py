"""What solvers and controllers do with QPs and data that are not nice, and what a sample costs then at most.

    python -m benchmarks.robustness [--json FILE] [--only qps,...] [--scale S]

At scale 1 the counts are those that the limits are meant for; a smaller scale is a quick look.
"""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.lib import command
from benchmarks.lib.report import Report
from benchmarks.lib.robustness import episodes, near_rest, qps, returns, violations, work, worst
from verification.qp.verdicts import replay as replay_qp
from verification.robustness.episodes import replay as replay_episode

PARTS: dict[str, Callable[[Report, float], None]] = {
    "qps": qps.measure,
    "returns": returns.measure,
    "episodes": episodes.measure,
    "near_rest": near_rest.measure,
    "work": work.measure,
    "worst": worst.measure,
    "violations": violations.measure,
}


def main() -> None:
    """All parts, or some."""
    parser = command.parser(__doc__, PARTS)
    command.add_scale(parser)
    parser.add_argument(
        "--replay", metavar="NAME", help="class/number/solver/precision or controller/episode: print it"
    )
    options = parser.parse_args()
    if options.replay:
        (replay_qp if options.replay.count("/") == 3 else replay_episode)(options.replay)
        return
    names, report = command.chosen(parser, options, PARTS), Report("robustness")
    command.measure(report, names, lambda name: PARTS[name](report, options.scale), options.json)


if __name__ == "__main__":
    main()
