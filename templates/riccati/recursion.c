/* Riccati recursion on the stage QP, shared by the Riccati solvers.
 *
 *     min  sum_{k<N} 1/2 z_k'M_k z_k + g_k'z_k  +  1/2 x_N'M_N x_N + g_N'x_N,   z = (x, u),
 *     x_{k+1} = S_k z_k + b_k,   u_j given if fixed[j] != 0,
 *
 *     M_k = Q_k + diag(0, diagonal[k]) + sum of weight[m] a_m a_m' over the rows m of stage k.
 *
 * The cost to go is 1/2 x'P_k x + p_k'x. After M_k := M_k + S_k'P_{k+1}S_k, with M_u its rows of the controls and
 * M_uu = L D L' its block of the free controls:   K = -M_uu^{-1} M_ux,   P_k = M_xx + M_ux'K.
 *
 * Contract
 *   riccati_init       once: sets everything to zero.
 *   riccati_factorize  M, L, K of the stages last .. 0 and P_last .. P_0 from Q, S, diagonal, weight, fixed; last = N:
 *                      all stages and P_N. Later stages are unchanged. Returns 0 if a pivot is not positive (its
 *                      stage is in `failed`), else 1.
 *   riccati_backward   p, feed, h of the stages last .. 0 from g, b, du (values of the fixed controls). Later stages
 *                      are unchanged.
 *   riccati_forward    x[1..N] and u of the minimiser from what is given of x[0].
 * The caller sets diagonal, weight, fixed, then g, b, du. The gradient g shares its memory with the work arrays of
 * riccati_factorize and with a direction (dx, du) that riccati_forward may write, so it must be set right before
 * riccati_backward. Symmetric matrices P_k are stored in full; their rows and columns NX .. LDX are padding. Products
 * are computed in blocks of four rows and eight columns, because compilers vectorise such loops without special
 * options. */

#include "riccati/linear_algebra.c"

#include "riccati/factorize.c"

#include "riccati/substitute.c"

#include "riccati/convexify.c"
