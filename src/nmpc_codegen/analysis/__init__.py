"""Analyses of Sources, made on request: how long can a sample take?"""

from __future__ import annotations

from collections.abc import Mapping

from nmpc_codegen.errors import OptionError


def worst_case(package: Mapping[str, str]) -> dict[str, int]:
    """Floating-point operations of a sample at most, whatever is measured, from the C text of the package.

    Comparisons and signs are included. All iterations that the caps allow are run, and the dearer branch is taken; see
    interpret.py. Caps are seldom reached: what is usual is far less.

    Args:
        package: path -> text of a package: what generate() returns, or the files of an exported folder.

    Returns:
        Operations of "prepare", of "feedback" and of the "sample" that calls both; of an algorithm without these phases
        those of a "sample" alone. Where a sample may take several QPs, those of "one iteration" are what remains of it
        with ``step(iterations=1)``.

    Raises:
        OptionError: the text does not bound them, as foreign code (OSQP) does not; or these are not the files of one
            package.
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
