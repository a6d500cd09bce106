/* Returns 1 if the sample may spend the given operations, and takes them from its allowance. Once it may not, the
 * allowance is 0 and nothing else is granted. A negative allowance has no limit. */
static int qp_afford(qp_t *q, int32_t operations)
{
    if (q->allowance >= 0) {
        q->allowance = operations <= q->allowance ? q->allowance - operations : 0;
        return q->allowance > 0;
    }
    return 1;
}
