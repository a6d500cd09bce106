"""Analyses of Sources are made on request; they bound the work of a sample."""

from __future__ import annotations

from collections.abc import Mapping

from nmpc_codegen.errors import OptionError


def worst_case(package: Mapping[str, str]) -> dict[str, int]:
    """Return an upper bound on the floating-point operations of a sample, for any measurement, from the C text.

    Comparisons and signs are included. All iterations that the caps allow are counted, and the more expensive branch is
    taken; see interpret.py. Caps are seldom reached: a usual sample takes far fewer operations.

    Args:
        package: {path: text}, as generate() returns it, or the files of an exported folder.

    Returns:
        Operations of "prepare", of "feedback" and of the "sample" that calls both; for an algorithm without these
            phases only those of a "sample". If a sample may take several QPs, "one iteration" has those of
            ``step(iterations=1)``.

    Raises:
        OptionError: the text does not bound the operations, as foreign code (OSQP) does not; or these are not the files
            of one package.
        ControllerError: <name>.json is not a package description.

    Examples:
        >>> from nmpc_codegen import generate
        >>> sorted(worst_case(generate(ocp)))
        ['feedback', 'prepare', 'sample']
    """
    if not isinstance(package, Mapping):
        raise OptionError(
            f"worst_case(): {type(package).__name__}; expected path -> text, e.g. what generate() returns"
        )
    from nmpc_codegen.analysis.sample import bound

    return bound(package)
