#include "riccati/recursion.c"

/* riccati_adjoint           lam = P_k x + p_k, the multiplier of x_k
 * riccati_control_gradient  derivative of the cost to go with respect to u_j at stage k, 0 at the minimiser if u_j is free: minus
 *                           the multiplier of a fixed control */

#include "riccati/adjoint.c"
