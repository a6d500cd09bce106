"""One item is shown on its way through the pipeline: python -m nmpc_codegen.lowering.unit crane.py --item feedback."""

from __future__ import annotations

import argparse
import runpy

from nmpc_codegen.decisions.decide import decide
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.completion.complete import complete
from nmpc_codegen.lowering.linearize import linearize
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.lowering.unit.assemble import assemble, constants_of
from nmpc_codegen.lowering.unit.pipeline import Items, run
from nmpc_codegen.options import Options


def show(title: str, items: Items, name: str) -> None:
    """Print the items that define a name, also as macro and as function of the interface."""
    for item in items:
        if not item.defines.isdisjoint((name, f"API({name})", name.upper())):
            head = item.name + (f"({item.arguments})" if item.arguments is not None else "")
            print(f"-- {title}: {item.kind} {head}\n{item.text}\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", help="a Python file with build_ocp() and, if it needs them, options()")
    parser.add_argument("--item", required=True, help="the name of a function, macro, table, type or constant")
    given = parser.parse_args()
    names = runpy.run_path(given.file)
    options = names.get("options", Options)()
    problem = complete(classify(names["build_ocp"](), options.algorithm.sampling_time), options)
    module = lower(linearize(problem, decide(problem, options)))
    items = assemble(module)
    show("as the parts have it", items, given.item)

    def watch(step: str, before: Items, after: Items) -> None:
        known = {(item.text, item.arguments) for item in before}
        show(f"after {step}", [i for i in after if (i.text, i.arguments) not in known], given.item)

    run(items, constants_of(module), watch)
