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
