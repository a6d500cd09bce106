"""A fault has a file, a text that occurs in it once, its replacement, and the nearest tests."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mutant:
    """``before`` occurs once in ``path`` and is replaced by ``after``; ``tests`` are arguments of pytest."""

    name: str
    path: str
    before: str
    after: str
    tests: tuple[str, ...]


MUTANTS = (
    Mutant(
        "a sign: the controls of a Riccati step",
        "templates/riccati/substitute.c",
        "? r->du[k * NU + j] : -y[j];",
        "? r->du[k * NU + j] : y[j];",
        ("tests/components/test_riccati_kernel.py",),
    ),
    Mutant(
        "a bound: upper bounds of the condensed QP are not relative to the iterate",
        "templates/condensing/full.c",
        "s->qp.upper[row] = control_upper(s, k, j) - s->u[k][j];",
        "s->qp.upper[row] = control_upper(s, k, j);",
        ("tests/components/test_condensing.py",),
    ),
    Mutant(
        "a sign: what x_0 adds to a coupled row",
        "templates/condensing/none.c",
        "value += s->coupled.J_0[row_index(m)][i] * s->step.dx[0][i];",
        "value -= s->coupled.J_0[row_index(m)][i] * s->step.dx[0][i];",
        ("tests/components/test_stage_qps.py",),
    ),
    Mutant(
        "a dropped term: terminal rows in the KKT residual",
        "templates/algorithms/shared/kkt.c",
        "terminal->J[j][i] * END_MULTIPLIERS(s)[j]);",
        "R(0));",
        ("tests/whole/test_solve.py",),
    ),
    Mutant(
        "rounding without a scale: hard rows after a step",
        "templates/algorithms/real_time_iteration/check_step.c",
        "TOL_ROUNDING * row_magnitude[row_id(m)]",
        "R(0) * row_magnitude[row_id(m)]",
        ("tests/verification/test_at_rest.py",),
    ),
    Mutant(
        "a check that cannot fail: the gradient after a step",
        "templates/algorithms/real_time_iteration/check_step.c",
        "if (!(over <= *least)) {\n            return 0;",
        "if (!(over <= *least)) {\n            return 1;",
        ("tests/decisions/test_open_loop_growth.py",),
    ),
    Mutant(
        "a transposed block: the factor of the free initial states",
        "templates/riccati/substitute.c",
        "y[f] -= r->F[i][f] * y[i];",
        "y[f] -= r->F[f][i] * y[i];",
        ("tests/components/test_stage_qps.py",),
    ),
    Mutant(
        "a stale multiplier: bounds of controls keep theirs when the plan is shifted",
        "templates/algorithms/shared/shift_by_one.c",
        "s->mu_u[k][j] = s->mu_u[from][j];",
        "s->mu_u[k][j] = s->mu_u[k][j];",
        ("tests/whole/test_closed_loop.py",),
    ),
    Mutant(
        "a dropped term: the second derivatives with respect to the controls",
        "src/nmpc_codegen/components/integrators/explicit/symmetric.py",
        " + self.curvature_forcing(H, units)",
        " + 0 * self.curvature_forcing(H, units)",
        ("tests/components/test_second_order.py",),
    ),
    Mutant(
        "a count that is too small: the last test of a loop in the worst case",
        "src/nmpc_codegen/analysis/interpret.py",
        "        return total + self.cost(test, scope)",
        "        return total",
        ("tests/analysis/test_interpret.py",),
    ),
    Mutant(
        "an effect that goes: a call in a condition that a constant decides",
        "src/nmpc_codegen/lowering/dialect/constants.py",
        "(right is decisive and not self.effects(first))",
        "right is decisive",
        ("tests/lowering/test_passes.py",),
    ),
    Mutant(
        "a member of another struct: a write to a member of size 0",
        "src/nmpc_codegen/lowering/simplify/functions.py",
        "(inner, place.word) in known.absent:",
        "place.word in dict(known.absent).values():",
        ("tests/lowering/test_passes.py",),
    ),
    Mutant(
        "a lost call: the value of a variable that nothing reads",
        "src/nmpc_codegen/lowering/simplify/functions.py",
        "effects.append(_for_its_effects(value.strip()))",
        "effects.clear()",
        ("tests/lowering/test_passes.py",),
    ),
    Mutant(
        "an operand without its parentheses: what constants leave of a condition",
        "src/nmpc_codegen/lowering/dialect/constants.py",
        "[1:3])] and _is_operand(inner)",
        "[1:3])] or _is_operand(inner)",
        ("tests/lowering/test_passes.py",),
    ),
    Mutant(
        "a loop that may run: its bounds are ranges",
        "src/nmpc_codegen/lowering/dialect/constants.py",
        "for ends in product(*values)]",
        "for ends in zip(*values)]",
        ("tests/lowering/test_passes.py",),
    ),
    Mutant(
        "a name without its definition: the verifier behind every pass",
        "src/nmpc_codegen/lowering/unit/pipeline.py",
        "if missing := sorted(lost & item.reads):",
        "if missing := sorted(lost & item.defines):",
        ("tests/lowering/test_unit.py",),
    ),
    Mutant(
        "a variable outside of its block: what a part must not do",
        "src/nmpc_codegen/lowering/dialect/scopes.py",
        "outside = scopes.free & scopes.declared",
        "outside = scopes.free & scopes.free - scopes.free",
        ("tests/lowering/test_passes.py",),
    ),
    Mutant(
        "a function that a macro calls: what is reached",
        "src/nmpc_codegen/lowering/unit/reach.py",
        "for name in found[place].reads for other",
        "for name in found[place].calls for other",
        ("tests/lowering/test_unit.py",),
    ),
    Mutant(
        "a sign: the noise of the plan in the prediction of the filter",
        "templates/algorithms/estimation/filter.c",
        "next[i] -= S[i][NX + j] * s->u[k][j];",
        "next[i] += S[i][NX + j] * s->u[k][j];",
        ("tests/whole/test_estimators.py",),
    ),
    Mutant(
        "a transposed factor: the information of the arrival cost",
        "templates/algorithms/estimation/window.c",
        "sum += V[l][i] * V[l][j];",
        "sum += V[i][l] * V[j][l];",
        ("tests/whole/test_estimators.py",),
    ),
    Mutant(
        "a status too early: an estimate on trial is called good",
        "templates/algorithms/estimation/innovation.c",
        "(w->doubted > EXPECTED_OUTLIERS || w->trial > 0)",
        "(w->doubted > EXPECTED_OUTLIERS)",
        ("tests/whole/test_innovations.py",),
    ),
    Mutant(
        "an index that is ignored: reset() of some controllers of a batch",
        "src/nmpc_codegen/runtime/batch/many.py",
        'self.call("PLAIN", "reset", index=chosen)',
        'self.call("PLAIN", "reset", index=None)',
        ("tests/runtime/batch",),
    ),
    Mutant(
        "a stream that begins anew: random numbers of a flight do not know its number",
        "src/nmpc_codegen/runtime/batch/random.py",
        "draw(signal, self.seed, self.first + i, out)",
        "draw(signal, self.seed, i, out)",
        ("tests/runtime/batch",),
    ),
    Mutant(
        "the first sample: a flight whose state is broken from the beginning is not lost",
        "src/nmpc_codegen/campaigns/judging/verdict.py",
        "found[flown.broken >= 0] = Reason.NOT_FINITE",
        "found[flown.broken > 0] = Reason.NOT_FINITE",
        ("tests/campaigns",),
    ),
    Mutant(
        "a part that is forgotten: its worker was lost",
        "src/nmpc_codegen/campaigns/flying/work.py",
        "self._again.append(replace(part, attempt=part.attempt + 1))",
        "self._again.append(part) if part.attempt < 0 else None",
        ("tests/campaigns",),
    ),
    Mutant(
        "a dropped term: equations in the derivatives of the stages",
        "templates/integrators/implicit/forward.c",
        "add_forcing(t, i, NX, NXA, R(1), U, n, own);",
        "add_forcing(t, i, NX, NXA, R(0), U, n, own);",
        ("tests/components/test_implicit.py",),
    ),
    Mutant(
        "a weight of another stage: the integral of a cost",
        "templates/integrators/implicit/quadrature.c",
        "*l += h * stage_weight[b * GROUP + i] * rate;",
        "*l += h * stage_weight[b * GROUP] * rate;",
        ("tests/components/test_implicit.py",),
    ),
    Mutant(
        "a start that is lost: algebraic variables from the declared values alone",
        "templates/integrators/implicit/algebraic.c",
        "(void)memcpy(point + NX, start, NALG * sizeof *point);\n    int reason",
        "(void)memcpy(point + NX, algebraic_start, NALG * sizeof *point);\n    int reason",
        ("tests/whole/test_algebraic.py",),
    ),
    Mutant(
        "a pivot that may vanish along the plan",
        "src/nmpc_codegen/frontend/algebra/elimination.py",
        " and not ca.depends_on(rows[i][j], moving):",
        ":",
        ("tests/frontend/test_algebra.py",),
    ),
    Mutant(
        "a plan that is not recorded: that of a sample that is not OK",
        "src/nmpc_codegen/runtime/records/recorder.py",
        " or status[0] != 0\n",
        "\n",
        ("tests/runtime/test_recorder.py",),
    ),
    Mutant(
        "a sample without its plan: what else is recorded of it is left out",
        "src/nmpc_codegen/runtime/records/recorder.py",
        "if planned or i >= len(layout.plan):",
        "if planned:",
        ("tests/runtime/test_recorder.py",),
    ),
)
