#if GENERAL_ROWS || NE
/* Stored gradient of the general or coupled row m: NZ entries at a path node, NX at the terminal node. For a coupled
 * row it is dr / dx_N. */
static inline const real_t *nodal_row(const solver_t *s, int m)
{
#if NE && GENERAL_ROWS
    if (IS_COUPLED(m)) {
        return s->coupled.J_N[row_index[m]];
    }
#endif
#if NH && NH_N
    return (row_node[m] < N) ? s->node[row_node[m]].J[row_index[m]] : s->terminal.J[row_index[m]];
#elif NH
    return s->node[row_node[m]].J[row_index[m]];
#elif NH_N
    return s->terminal.J[row_index[m]];
#else
    return s->coupled.J_N[row_index[m]];
#endif
}

#endif
#if NG && HAS_QP && (CONDENSED_QP || ROW_SCALES || (HARD_ROWS && CHECK_STEP))
/* Sum of the magnitudes of the terms of row m, where size[] holds those of (dx, du). */
static real_t row_terms(const solver_t *s, int m, const real_t *size)
{
    const real_t constant = FABS(ROW_CONSTANT(s, m));
#if STATE_ROWS && (GENERAL_ROWS || NE)
    if (row_kind[m] == ROW_STATE) {
        return constant + size[row_index[m]];
    }
#elif STATE_ROWS
    return constant + size[row_index[m]];
#endif
#if GENERAL_ROWS || NE
    const real_t *J = nodal_row(s, m);
    real_t terms = constant;
    for (int i = 0; i < (row_node[m] < N ? NZ : NX); i++) {
        terms += FABS(J[i]) * size[i];
    }
    return terms;
#endif
}

#endif
