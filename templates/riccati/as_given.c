/* riccati_convexify   before qp_factorize: the Hessian is convex, or stays as it is. Returns 1 if the factors at hand are those
 *                     without given controls and without rows. */
static inline int riccati_convexify(solver_t *s)
{
    (void)s;
    return 0;
}
