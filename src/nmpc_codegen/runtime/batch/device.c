/* The kernel interleaves the words of the structs in memory, so that neighbouring threads read neighbouring words;
 * while a thread works, its struct is a local variable. There is one kernel for all operations, because each kernel
 * would have its own copy of all functions. */

#define WORDS (sizeof(PACKAGE(solver_t)) / sizeof(uint32_t))

/* Copies a struct out of the interleaved words. */
TARGET static void batch_load(PACKAGE(solver_t) *s, const uint32_t *words, int64_t structs, int64_t i)
{
    for (size_t w = 0; w < WORDS; w++) {
        memcpy((char *)s + w * sizeof(uint32_t), &words[(int64_t)w * structs + i], sizeof(uint32_t));
    }
}

/* Copies a struct back to the interleaved words. */
TARGET static void batch_store(const PACKAGE(solver_t) *s, uint32_t *words, int64_t structs, int64_t i)
{
    for (size_t w = 0; w < WORDS; w++) {
        memcpy(&words[(int64_t)w * structs + i], (const char *)s + w * sizeof(uint32_t), sizeof(uint32_t));
    }
}

/* Returns NaN, as there is no clock. */
TARGET static double batch_now(void)
{
    const uint64_t bits = (uint64_t)0x7FF8 << 48;
    double none;
    memcpy(&none, &bits, sizeof none);
    return none;
}

TARGET static int32_t batch_call_step(const batch_flights_t *f, void *s, const real_t *xhat, real_t *u)
{
    (void)f;
    return (int32_t)PACKAGE(step)((PACKAGE(solver_t) *)s, xhat, u);
}

TARGET static void batch_call_integrate(
    const batch_flights_t *f, const void *plant, const real_t *x, const real_t *u, real_t dt, real_t *x_next)
{
    (void)f;
    PACKAGE(integrate)((const PACKAGE(solver_t) *)plant, x, u, dt, x_next);
}

TARGET static void batch_call_algebraic(
    const batch_flights_t *f, void *s, const real_t *x, const real_t *u, real_t *z)
{
    (void)f;
#if HAS_ALGEBRAIC
    (void)PACKAGE(algebraic)((PACKAGE(solver_t) *)s, 0, x, u, z); /* NaN where there is no solution */
#else
    (void)s;
    (void)x;
    (void)u;
    z[0] = (real_t)0;
#endif
}

/* Passes rows to a setter. */
TARGET static int32_t batch_hand_over(const batch_data_t *d, void *data, const real_t *rows)
{
    PACKAGE(solver_t) *s = (PACKAGE(solver_t) *)data;
    int32_t refused = 0;
    switch (d->setter) {
#if HAS_SET_TERMINAL_REFERENCE
    case BATCH_TERMINAL_REFERENCE:
        return (int32_t)PACKAGE(set_terminal_reference)(s, rows);
#endif
#if HAS_SET_REFERENCE_RANGE
    case BATCH_REFERENCE:
        return (int32_t)PACKAGE(set_reference_range)(s, 0, d->nodes, rows);
#elif HAS_SET_REFERENCE
    case BATCH_REFERENCE:
        return (int32_t)PACKAGE(set_reference)(s, ALL, rows);
#endif
#if HAS_SET_BOUNDS_RANGE
    case BATCH_BOUNDS:
        return (int32_t)PACKAGE(set_bounds_range)(s, d->number, 0, d->nodes, rows, rows + d->nodes);
#elif HAS_SET_BOUNDS
    case BATCH_BOUNDS:
        return (int32_t)PACKAGE(set_bounds)(s, d->number, ALL, rows[0], rows[d->nodes]);
#endif
#if HAS_SET_PARAMETER_RANGE
    case BATCH_PARAMETER:
        return (int32_t)PACKAGE(set_parameter_range)(s, d->number, 0, d->nodes, rows);
#elif HAS_SET_PARAMETER
    case BATCH_PARAMETER: /* of the path, then of node N */
        for (int32_t n = 0; n < d->nodes && !refused; n++) {
            refused = (int32_t)PACKAGE(set_parameter)(s, d->number, (n == 0) ? ALL : d->end, rows + n * d->width);
        }
        return refused;
#endif
    default:
        return refused;
    }
}

#include "random.c"

#include "flight.c"

/* Runs a call of one controller. */
TARGET static int32_t batch_on(const batch_launch_t *l, int64_t t, PACKAGE(solver_t) *s)
{
    const real_t *first = (const real_t *)l->first + t * NX;
    switch (l->operation) {
#if HAS_PREPARE
    case BATCH_ON_PREPARE:
        return (int32_t)PACKAGE(prepare)(s);
    case BATCH_ON_FEEDBACK:
        return (int32_t)PACKAGE(feedback)(s, first, (real_t *)l->out + t * NU);
#endif
#if HAS_SOLVE
    case BATCH_ON_SOLVE:
        return (int32_t)PACKAGE(solve)(s, first, (real_t)l->number, l->count);
#endif
#if HAS_SHIFT
    case BATCH_ON_SHIFT:
        return (int32_t)PACKAGE(shift)(s);
#endif
    case BATCH_ON_STEP:
        return (int32_t)PACKAGE(step)(s, first, (real_t *)l->out + t * NU);
    case BATCH_ON_RESET:
        return (int32_t)PACKAGE(reset)(s);
    case BATCH_ON_INTEGRATE:
        PACKAGE(integrate)(s, first, (const real_t *)l->second + t * NU, (real_t)l->number, (real_t *)l->out + t * NX);
        return 0;
    case BATCH_ON_COST:
        ((real_t *)l->out)[t] = PACKAGE(cost)(s);
        return 0;
    default:
        return 0;
    }
}

/* Runs a flight, on a copy if one controller, or one plant, serves all flights. */
TARGET static int32_t batch_fly_there(const batch_launch_t *l, int64_t t, PACKAGE(solver_t) *s)
{
    const batch_place_t *p = &l->flights.plant;
    const int64_t flight = l->from + t;
    PACKAGE(solver_t) plant;
    real_t rows[ROWS];
    if (p->memory == NULL) {
        return batch_fly_one(&l->flights, flight, t, s, s, rows);
    }
    batch_load(&plant, (const uint32_t *)(const void *)p->memory, p->structs, (p->structs == 1) ? 0 : flight);
    return batch_fly_one(&l->flights, flight, t, s, &plant, rows);
}

/* Runs the operation of a thread for its controller. */
KERNEL batch_all(const batch_launch_t *l)
{
    const int64_t t = THREAD;
    const int fly = l->operation == BATCH_ON_FLY, copy = l->operation == BATCH_ON_COPY;
    const int one = copy || (fly && l->structs == 1);
    PACKAGE(solver_t) s;
    if (t < l->threads) {
        const int64_t i = (l->index == NULL) ? l->from + t : l->index[t];
        batch_load(&s, copy ? (const uint32_t *)l->first : l->words, one ? 1 : l->structs, one ? 0 : i);
        l->status[t] = fly ? batch_fly_there(l, t, &s) : batch_on(l, t, &s);
        if (!fly || l->structs > 1) {
            batch_store(&s, l->words, l->structs, i);
        }
    }
}
