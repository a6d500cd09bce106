/* Functions of the packages are called by their addresses, and threads share the calls. */

#define ALIGNED(bytes) (((bytes) + 63) / 64 * 64)

#ifdef __TINYC__ /* it has no atomic operations: every thread keeps to its own share */
#define SHARES(threads) 1
#define CLAIM(next, chunk) ((*(next) += (chunk)) - (chunk))
#else
#define SHARES(threads) (threads)
#define CLAIM(next, chunk) __atomic_fetch_add(next, chunk, __ATOMIC_RELAXED)
#endif

typedef int (*plain_t)(void *s);
typedef int (*sample_t)(void *s, const real_t *x, real_t *u);
typedef int (*solve_t)(void *s, const real_t *x, real_t tol, int max_iterations);
typedef void (*integrate_t)(const void *s, const real_t *x, const real_t *u, real_t dt, real_t *x_next);
typedef real_t (*cost_t)(const void *s);
typedef int (*algebraic_t)(void *s, int k, const real_t *x, const real_t *u, real_t *z);
typedef int (*set_t)(void *s, const real_t *v);
typedef int (*set_node_t)(void *s, int a, const real_t *v);
typedef int (*set_two_t)(void *s, int a, int b, const real_t *v);
typedef int (*set_three_t)(void *s, int a, int b, int c, const real_t *v);
typedef int (*set_pair_t)(void *s, int a, int b, real_t v, real_t w);
typedef int (*set_pairs_t)(void *s, int a, int b, int c, const real_t *v, const real_t *w);

/* Returns the seconds of a monotonic clock. */
static double batch_now(void)
{
    struct timespec t;
    (void)clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int32_t batch_call_step(const batch_flights_t *f, void *s, const real_t *xhat, real_t *u)
{
    return ((sample_t)f->step)(s, xhat, u);
}

static void batch_call_integrate(
    const batch_flights_t *f, const void *plant, const real_t *x, const real_t *u, real_t dt, real_t *x_next)
{
    ((integrate_t)f->integrate)(plant, x, u, dt, x_next);
}

static void batch_call_algebraic(const batch_flights_t *f, void *s, const real_t *x, const real_t *u, real_t *z)
{
    (void)((algebraic_t)f->algebraic)(s, 0, x, u, z); /* NaN where there is no solution */
}

/* Passes rows to a setter. */
static int32_t batch_hand_over(const batch_data_t *d, void *s, const real_t *rows)
{
    int refused = 0;
    if (d->setter == BATCH_TERMINAL_REFERENCE) {
        return ((set_t)d->set)(s, rows);
    }
    if (d->setter == BATCH_BOUNDS) {
        return (d->set_range != NULL)
            ? ((set_pairs_t)d->set_range)(s, d->number, 0, d->nodes, rows, rows + d->nodes)
            : ((set_pair_t)d->set)(s, d->number, ALL, rows[0], rows[d->nodes]);
    }
    if (d->setter == BATCH_REFERENCE) {
        return (d->set_range != NULL) ? ((set_two_t)d->set_range)(s, 0, d->nodes, rows)
                                      : ((set_node_t)d->set)(s, ALL, rows);
    }
    if (d->set_range != NULL) {
        return ((set_three_t)d->set_range)(s, d->number, 0, d->nodes, rows);
    }
    for (int32_t n = 0; n < d->nodes && !refused; n++) { /* of the path, then of node N */
        refused = ((set_two_t)d->set)(s, d->number, (n == 0) ? ALL : d->end, rows + n * d->width);
    }
    return refused;
}

#include "random.c"

#include "flight.c"

/* Copies the struct of a flight, and returns the copy. */
static void *batch_copy_of(const batch_place_t *place, int64_t flight, char *copy)
{
    return memcpy(copy, place->memory + flight * place->stride, (size_t)place->size);
}

int32_t batch_fly(const batch_flights_t *f, int64_t from, int64_t until)
{
    const batch_place_t *c = &f->controller, *p = &f->plant;
    int32_t refused = 0;
    for (int64_t i = from; i < until && !refused; i++) {
        void *s = c->stride ? c->memory + i * c->stride : batch_copy_of(c, i, f->copies);
        void *plant = (p->memory == NULL) ? s : batch_copy_of(p, i, f->copies + ALIGNED(c->size));
        refused = batch_fly_one(f, i, i - from, s, plant, (real_t *)f->rows);
    }
    return refused;
}

int32_t batch_fly_sample(const batch_flights_t *f, int64_t k, void *xhat)
{
    void *s = f->controller.memory, *plant = (f->plant.memory == NULL) ? s : f->plant.memory;
    return batch_fly_one_sample(f, 0, 0, k, s, plant, (real_t *)f->rows, (real_t *)xhat);
}

int32_t batch_tell_sample(const batch_flights_t *f, int64_t k)
{
    void *s = f->controller.memory, *plant = (f->plant.memory == NULL) ? s : f->plant.memory;
    return batch_tell_both(f, 0, k, s, plant, (real_t *)f->rows);
}

void batch_draw(
    const batch_random_t *r, uint64_t seed, int64_t flight, int64_t from, int64_t count, int32_t n, double *out)
{
    for (int64_t k = 0; k < count; k++) {
        batch_draw_sample(r, seed, flight, from + k, n, out + k * n);
    }
}

/* Runs call number i. */
static int batch_call_one(const batch_call_t *c, int64_t i)
{
    void *s = c->memory + ((c->index == NULL) ? i : c->index[i]) * c->stride;
    const real_t *first = (const real_t *)((const char *)c->first + i * c->first_step);
    const real_t *second = (const real_t *)((const char *)c->second + i * c->second_step);
    real_t *out = (real_t *)((char *)c->out + i * c->out_step);
    const int32_t *at = c->place;
    switch (c->operation) {
    case BATCH_COPY:
        memcpy(s, c->first, (size_t)c->stride);
        return 0;
    case BATCH_PLAIN:
        return ((plain_t)c->function)(s);
    case BATCH_SAMPLE:
        return ((sample_t)c->function)(s, first, out);
    case BATCH_SOLVE:
        return ((solve_t)c->function)(s, first, (real_t)c->number, at[0]);
    case BATCH_INTEGRATE:
        ((integrate_t)c->function)(s, first, second, (real_t)c->number, out);
        return 0;
    case BATCH_COST:
        *out = ((cost_t)c->function)(s);
        return 0;
    case BATCH_SET:
        return ((set_t)c->function)(s, first);
    case BATCH_SET_NODE:
        return ((set_node_t)c->function)(s, at[0], first);
    case BATCH_SET_TWO:
        return ((set_two_t)c->function)(s, at[0], at[1], first);
    case BATCH_SET_THREE:
        return ((set_three_t)c->function)(s, at[0], at[1], at[2], first);
    case BATCH_SET_PAIR:
        return ((set_pair_t)c->function)(s, at[0], at[1], *first, *second);
    default:
        return ((set_pairs_t)c->function)(s, at[0], at[1], at[2], first, second);
    }
}

void batch_run(const batch_call_t *c, int32_t t)
{
    const batch_work_t *w = &c->work;
    for (int32_t v = 0; v < SHARES(w->threads); v++) { /* its own share, then those of others */
        const int32_t share = (t + v) % w->threads;
        const int64_t end = w->count * (share + 1) / w->threads;
        int64_t *next = &w->next[8 * share];
        for (int64_t from = CLAIM(next, w->chunk); from < end; from = CLAIM(next, w->chunk)) {
            const int64_t until = (from + w->chunk < end) ? from + w->chunk : end;
            for (int64_t i = from; i < until; i++) {
                c->status[i] = batch_call_one(c, i);
            }
        }
    }
}
