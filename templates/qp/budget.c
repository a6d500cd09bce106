/* Takes the given operations from the allowance of the sample. Returns 0, and sets the allowance to 0, if they exceed it.
 * A negative allowance has no limit. */
static int qp_afford(qp_t *q, int32_t operations)
{
    if (q->allowance >= 0 && operations > q->allowance) {
        q->allowance = 0;
        return 0;
    }
    q->allowance -= q->allowance >= 0 ? operations : 0;
    return 1;
}
