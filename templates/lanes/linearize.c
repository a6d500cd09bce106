#include "lanes/vector.c"

#if LANE_CONDITIONS
#include "lanes/conditions.c"
#endif

#if LANE_SQRT
#include "lanes/sqrt.c"
#endif

#if LANE_ANGLES
#include "lanes/large_angles.c"
#endif

#include "generated/lane_functions.c"

#include "generated/lane_kernels.c"

/* Numbers between the data of two nodes. */
#define NODE_STRIDE ((int)(sizeof s->node[0] / sizeof(real_t)))

#include "generated/lane_nodes.c"

#if LAGRANGIAN
/* The adjoint sweep that provides multipliers goes from node to node. */
static void linearize_one_by_one(solver_t *s)
{
    real_t x_next[NX];
    for (int k = N - 1; k >= 0; k--) {
        expand_node(s, k, x_next);
        complete_node(s, k, x_next, &s->node[k]);
    }
}

#endif
/* Linearises all path nodes, VECTOR_LANES at once; the last group overlaps the one before it if N is no multiple. */
static void linearize_lanes(solver_t *s)
{
#if LAGRANGIAN
    if (!has_multipliers(s)) {
        linearize_one_by_one(s);
        return;
    }
    start_expansion(s);
#endif
    for (int k = 0; k < N; k += VECTOR_LANES) {
        linearize_group(s, (k < N - VECTOR_LANES) ? k : N - VECTOR_LANES);
    }
    for (int k = 0; k < N; k++) {
        for (int i = 0; i < NX; i++) {
            s->node[k].b[i] -= s->x[k + 1][i];
        }
    }
}
