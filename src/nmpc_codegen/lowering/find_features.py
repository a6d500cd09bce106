"""The features of a package come from the problem, the options, the target and the components."""

from __future__ import annotations

from dataclasses import replace

from nmpc_codegen.lowering.linearize import Model
from nmpc_codegen.lowering.stated.data import is_set
from nmpc_codegen.lowering.tables import control_rows
from nmpc_codegen.package.features import KERNELS, Features, KernelName


def features_of(model: Model) -> Features:
    """Return the features of the problem, options and target, those that components add, and derived ones."""
    p, parts = model.problem, model.parts
    found = _features_of_problem(model)
    for component in parts.components:
        found = component.adds(found)
    tuned = found.tuned and (found.set_parameter or found.set_weight or found.set_bounds or found.set_soft)
    exact = bool(model.exact or found.regularize_reduced)
    bends = found.has_qp and (p.nonlinear_model or p.nonlinear_rows or p.nonlinear_cost or found.tuned)
    goes_on = bends and found.judges and found.iterates
    search = found.has_qp and (found.solve or goes_on)
    curved = search and exact and not p.couples_free_start
    relaxable = found.hard_rows and (search or found.solve or found.relax)
    nonlinear = found.has_qp and p.nonlinear_rows
    eliminates = parts.condensing is not None and parts.condensing.gives == "condensed"
    return replace(
        found,
        kernels=found.kernels | _gradients_of_cost(model, found, eliminates),
        tuned=tuned,
        takes_penalties=found.set_soft and found.has_qp,
        two_hessians=bool(model.exact),
        curved=curved,
        keeps_multipliers=curved or found.stage_multipliers,
        relaxation=relaxable,
        priced_rows=found.relax
        and any(k < p.N and p.rows[row].hard and p.rows_on_states[row] for k, _, _, row in p.qp_rows),
        elastic=relaxable or any(row.soft is not None for row in p.rows),
        nonlinear_rows=nonlinear,
        nonlinear_model=found.has_qp and p.nonlinear_model,
        search=search,
        judges=bends and found.judges,
        iterates=goes_on,
        exact_qp=found.has_qp and not bends,
        shifts_back=goes_on and parts.algorithm.shift == "repeat" and not found.idle_end,
        row_scales=relaxable or nonlinear or search,
        check_step=eliminates and not found.approximate,
    )


def _features_of_problem(model: Model) -> Features:
    """Return the features of the problem, the options and the target."""
    p, parts, target = model.problem, model.parts, model.target
    kinds, imposed = {kind for _, kind, _, _ in p.qp_rows}, {(k, row) for k, _, _, row in p.qp_rows}
    eliminates = parts.condensing is not None and parts.condensing.gives == "condensed"
    computing = {r.name for r in model.printed}
    computing |= {"state_step", "adjoint_step"} if eliminates else set()
    core, layouts = parts.algorithm.core, model.options.online.layouts
    return Features(
        kernels=frozenset(name for name in KERNELS if name in computing),
        set_reference=is_set(model, "reference"),
        set_weight=is_set(model, "weight"),
        set_parameter=is_set(model, "parameter"),
        set_bounds=is_set(model, "bounds"),
        set_soft=is_set(model, "soft"),
        reference_by_node=layouts["reference"] == "node",
        weight_by_node=layouts["weight"] == "node",
        parameter_by_node=layouts["parameter"] == "node",
        bounds_by_node=layouts["bounds"] == "node",
        soft_by_node=layouts["soft"] == "node",
        state_rows=0 in kinds,
        general_rows=1 in kinds,
        hard_rows=any(p.rows[row].hard for _, _, _, row in p.qp_rows),
        rows_move=any((k + 1, row) in imposed for k, row in imposed),
        proximal=bool(p.proximal),
        saddles=any(slope >= 0 for slope in model.problem.saddles.slopes),
        idle_states=any(model.problem.saddles.drivers),
        idle_end=p.idle_end and parts.algorithm.shift == "repeat",
        end_equations=any(k == p.N and p.rows[row].is_equation for k, _, _, row in p.qp_rows),
        pulled_rows=bool(p.pulled_rows),
        control_bounds=any(place >= 0 for place in control_rows(p)),
        accumulators=bool(p.accumulators),
        all_measured=not p.accumulators and not p.free_initial,
        augmented=bool(p.augmentation.count),
        previous=bool(p.augmentation.previous),
        timed=p.augmentation.time,
        estimator=p.estimation is not None,
        known_controls=p.estimation is not None and p.estimation.nu > 0,
        solve=model.options.solves,
        nodes="nodes" in core,
        products="products" in core,
        kkt="kkt" in core,
        has_qp="qp" in parts.algorithm.needs,
        stage_multipliers=not eliminates,
        terminal_block=bool(model.products.Q_N),
        single=model.options.precision == "single",
        own_math=model.options.math == "own",
        small=model.options.goal == "size",
        scalar=target.sums == "variables" or model.options.goal == "size",
        avx512=target.avx512,
    )


def _gradients_of_cost(model: Model, found: Features, eliminates: bool) -> set[KernelName]:
    """Return the names of products g + Q z over the nonzeros.

    They are used for elimination, and on stages if the Hessian keeps few nonzeros.
    """
    changes = found.regularize_stages or found.regularize_reduced
    changes |= found.has("start_hessian") or found.has("initial_hessian")
    keeps = model.parts.condensing is not None and not changes
    path, terminal = model.products.sparse
    kernels: set[KernelName] = {"cost_gradient"} if keeps and not eliminates and path else set()
    return kernels | ({"terminal_adjoint"} if eliminates or (keeps and terminal) else set())
