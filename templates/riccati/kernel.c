#include "riccati/recursion.c"

/* riccati_adjoint           lam = P_k x + p_k, the multiplier of x_k
 * riccati_control_gradient  derivative of the cost to go with respect to u_j at stage k: at the minimiser 0 for a free
 *                           control, minus the multiplier for a fixed one */

#include "riccati/adjoint.c"
