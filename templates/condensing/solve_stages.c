static status_t condense_solve(solver_t *s)
{
    status_t status;
    condense_embed(s);
    status = qp_solve(s);
    condense_expand(s);
    return status;
}
