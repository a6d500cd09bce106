"""No function of a package is longer than a screen, unless it is one function of the user's model."""

from __future__ import annotations

import re

import pytest

from verification.rendered import texts
from verification.samples import SAMPLES
from verification.timed import Sample

LONGEST = 60

#: Samples of which the fast tests look at the functions.
FEW = ("crane", "crane without solve", "cstr", "everything looped", "vessel augmented", "slewed dense", "stiff dense")

#: A function that starts a line, until the brace that ends it.
FUNCTION = re.compile(r"^(?:static |API)[^;{}]*?\b(\w+)\)?\([^;{}]*\)\n\{\n.*?^\}", re.MULTILINE | re.DOTALL)

#: The user's functions and their derivatives: what a call of f, of the cost or of a row evaluates at a point, and the
#: products of their derivatives with a column.
OF_MODEL = re.compile(
    r"(?:path|terminal|start|stage|coupled|initial)_(?:cost|gradient|hessian|product|rows|curvature|slopes|equation"
    r"|exact_of_data)\w*"
    r"|(?:integrator|path_exact|interval)\w*_(?:f|taped_f|tape|slopes|linearize_f|f_and_tangent|node|backward_\d"
    r"|curvature|derivatives_at_all_stages|curvatures_at_all_stages)"
    r"|\w+_(?:sensitivities|adjoint)_of_stages?_\d\w*"
)

#: Products with the matrices of a stage, written out over their nonzeros, are a little longer.
PRODUCTS, LONGEST_PRODUCT = re.compile(r"condense_\w+_panel|adjoint_step"), 64


def too_long(text: str) -> dict[str, int]:
    """Name -> lines of the functions of a .c that are too long."""
    found = {m[1]: m[0].count("\n") + 1 for m in FUNCTION.finditer(text)}
    assert len(found) > 50, "the pattern finds no functions"
    return {
        name: lines
        for name, lines in found.items()
        if lines > (LONGEST_PRODUCT if PRODUCTS.fullmatch(name) else LONGEST) and not OF_MODEL.fullmatch(name)
    }


@pytest.mark.parametrize("sample", [s for s in SAMPLES if s.name in FEW], ids=lambda s: s.name)
def test_functions_fit_a_screen(sample: Sample) -> None:
    sources = texts(sample)
    (name,) = (path for path in sources if path.endswith(".c") and path != "main.c" and "/" not in path)
    assert too_long(sources[name]) == {}


@pytest.mark.slow
@pytest.mark.parametrize("sample", [s for s in SAMPLES if s.name not in FEW], ids=lambda s: s.name)
def test_functions_of_all_samples_fit_a_screen(sample: Sample) -> None:
    test_functions_fit_a_screen(sample)


def test_a_long_function_is_found() -> None:
    short = "".join(f"static void f_{n}(int a)\n{{\n    use(a);\n}}\n\n" for n in range(51))
    body = "    use(a);\n" * LONGEST
    assert too_long(f"{short}static void g(int a)\n{{\n{body}}}\n") == {"g": LONGEST + 3}
    assert too_long(f"{short}static void path_cost(int a)\n{{\n{body}}}\n") == {}
