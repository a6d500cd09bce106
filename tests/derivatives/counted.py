"""Operations of the functions of a package of derivatives, counted at run time."""

from __future__ import annotations

from nmpc_codegen.package.opcount import OpCount
from nmpc_codegen.package.sources import Sources
from verification.counting import CLASSES, run_program

#: Arguments of every function after the data.
ARGUMENTS = {
    "simulate": "&t",
    "sensitivities": "&m",
    "sensitivities_alternative": "0, &s",
    "gradient_finite_differences": "1e-3, &t, out",
    "gradient_forward": "&m, out",
    "gradient_adjoint": "&n, out",
    "gradient_adjoint_matrices": "&m, out",
    "gradient_alternative": "&s, out",
    "hessians_symmetric": "lam, &h",
    "hessians_forward_over_adjoint": "lam, &h",
    "impulse_response_finite_differences": "1e-3, &t, Xi",
    "impulse_response_forward": "&m, Xi",
    "impulse_response_adjoint": "rows, PREFIX_N * PREFIX_NOUT, &n, Xi",
    "impulse_response_adjoint_matrices": "rows, PREFIX_N * PREFIX_NOUT, &m, Xi",
    "impulse_response_alternative": "&s, Xi",
}


def counted(sources: Sources, name: str, functions: list[str]) -> dict[str, OpCount]:
    """Operations of one run of each function at the declared data."""
    declarations = [
        *(f"static {name}_{struct}_t {v};" for v, struct in zip("dtnmsh", STRUCTS, strict=True)),
        "static real_t lam[PREFIX_N * PREFIX_NX];",
        *OUTPUTS[any(f.startswith("impulse_response") for f in functions)],
    ]
    start = [f"    {name}_init(&d);", f"    {name}_sensitivities(&d, &m);"]
    calls = {f: f"{name}_{f}(&d, {ARGUMENTS.get(f, '&m, Xi')})" for f in functions}
    found = run_program(sources, name, declarations, start, {}, calls)
    return {f: OpCount(**dict(zip(CLASSES, found[f].values(), strict=True))) for f in functions}


STRUCTS = ("data", "trajectory", "nodes", "linearization", "response", "hessians")
OUTPUTS = {
    False: ["static real_t out[PREFIX_N][PREFIX_NU];"],
    True: [
        "static int rows[PREFIX_N * PREFIX_NOUT];",
        "static int numbered() { for (int i = 0; i < PREFIX_N * PREFIX_NOUT; i++) { rows[i] = i; } return 0; }",
        "static int ready = numbered();",
        "static real_t out[PREFIX_N][PREFIX_NU];",
        "static real_t Xi[PREFIX_N * PREFIX_NOUT][PREFIX_N][PREFIX_NU];",
    ],
}
