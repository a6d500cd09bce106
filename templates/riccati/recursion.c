/* Riccati recursion on the stage QP, shared by the Riccati solvers.
 *
 *     min  sum_{k<NS} 1/2 z_k'M_k z_k + g_k'z_k  +  1/2 x_NS'M_NS x_NS + g_NS'x_NS,   z = (x, u),   x_{k+1} = S_k z_k + b_k
 *
 *     M_k = Q_k + diag(0, diagonal[k]) + sum of weight[m] a_m a_m' over the rows m of stage k;   u_j given where fixed[j] != 0
 *
 * Cost to go 1/2 x'P_k x + p_k'x. With M_k := M_k + S_k'P_{k+1}S_k, its rows M_u of the controls and M_uu = L D L' of those that
 * are free:   K = -M_uu^{-1} M_ux,   P_k = M_xx + M_ux'K.
 *
 * Contract
 *   riccati_init       once: everything zero.
 *   riccati_factorize  M, L, K of the stages last .. 0 and P_last .. P_0 from Q, S, diagonal, weight, fixed (last = NS: all of
 *                      them, P_NS too). Later stages stand. 0: a pivot is not positive (stage in failed), else 1.
 *   riccati_backward   p, feed, h of the stages last .. 0 from g, b, du (values of the fixed controls); later ones stand.
 *   riccati_forward    x[1..NS] and u of the minimiser, from x[0]; its free components are computed.
 * The caller sets diagonal, weight, fixed, then g, b, du. The gradient g shares its memory with the scratch of riccati_factorize
 * and with a direction (dx, du) that riccati_forward may write: it is set right before riccati_backward.
 * Symmetric matrices P_k are stored in full; their rows and columns NXS .. LDX are padding. Products run in blocks of four rows
 * and eight columns: such loops are the ones that compilers turn into vector operations without being asked to. */

#include "riccati/linear_algebra.c"

#include "riccati/factorize.c"

#include "riccati/substitute.c"

#if REGULARIZE_REDUCED
#include "riccati/convexify.c"
#endif
