/* Replays a recorded closed loop and writes ticks, stack and results of every call for the host. Contract: recording.h
 * holds the inputs. Every line begins with a letter; all numbers are hexadecimal words:
 *     E ticks stack                        a call of a function that does nothing
 *     I ticks stack status                 init()
 *     S ticks stack status ticks stack status u0...   prepare(), feedback() of a sample; u0 in words, low word first
 *     O number ticks stack                 another entry point, in the order of others[] in the host's code
 * stack: bytes below the caller's stack pointer that the call has written. */
#include "recording.h"
#include "start.h"

#include <stdint.h>
#include <string.h>

#define PAINT 0xA5C3F00Du
#define ALONE __attribute__((noinline, noclone))
#define INSIDE static inline __attribute__((always_inline))

typedef struct {
    uint32_t ticks, stack;
    int status;
} cost_t;

static solver_t solver;
static real_t x[INPUTS], u[OUTPUTS];
#if HAS_MODEL
static CALL(kkt_t) residuals;
#else
static real_t covariance[OUTPUTS * OUTPUTS];
#endif

INSIDE void paint(void)
{
    volatile uint32_t *const end = image_stack_pointer();
    for (volatile uint32_t *word = image_stack_limit; word < end; word++) {
        *word = PAINT;
    }
}

INSIDE uint32_t written_bytes(void)
{
    volatile uint32_t *const end = image_stack_pointer();
    volatile uint32_t *word = image_stack_limit;
    while (word < end && *word == PAINT) {
        word++;
    }
    return (uint32_t)((uintptr_t)end - (uintptr_t)word);
}

/* Defines a function, never inlined, that measures ticks and stack of one call. Its helpers are inlined, so that their
 * stack pointer is that of the function. */
#define MEASURED(name, call)                                                                                           \
    ALONE static cost_t measured_##name(void)                                                                          \
    {                                                                                                                  \
        cost_t cost;                                                                                                   \
        paint();                                                                                                       \
        const uint32_t start = image_clock();                                                                          \
        cost.status = (int)(call);                                                                                     \
        cost.ticks = image_clock() - start;                                                                            \
        cost.stack = written_bytes();                                                                                  \
        return cost;                                                                                                   \
    }

ALONE static int nothing(solver_t *s)
{
    __asm volatile("" : : "r"(s) : "memory");
    return 0;
}

MEASURED(nothing, nothing(&solver))
MEASURED(init, CALL(init)(&solver))
MEASURED(prepare, PREPARE(&solver))
MEASURED(feedback, CONTROL(&solver, x, u))
MEASURED(step, SAMPLE(&solver, x, u))
MEASURED(reset, CALL(reset)(&solver))
#if HAS_MODEL
MEASURED(integrate, (CALL(integrate)(&solver, x, u, (real_t)0.001, x), 0))
MEASURED(cost, (int)(CALL(cost)(&solver) > (real_t)0))
MEASURED(shift, CALL(shift)(&solver))
MEASURED(kkt, (CALL(kkt)(&solver, &residuals), 0))
#else
MEASURED(covariance, CALL(covariance)(&solver, covariance))
#endif
#if HAS_SOLVE
MEASURED(solve, CALL(solve)(&solver, x, (real_t)1e-3, 20))
#endif

static void put_word(uint32_t word)
{
    image_put(' ');
    for (int shift = 28; shift >= 0; shift -= 4) {
        image_put("0123456789abcdef"[(word >> shift) & 15u]);
    }
}

static void put_cost(cost_t cost, int with_status)
{
    put_word(cost.ticks);
    put_word(cost.stack);
    if (with_status) {
        put_word((uint32_t)cost.status);
    }
}

static void put_other(uint32_t number, cost_t cost)
{
    image_put('O');
    put_word(number);
    put_cost(cost, 0);
    image_put('\n');
}

static void sample(int k)
{
    before_sample(&solver, k);
    (void)memcpy(x, recorded_x[k], sizeof x);
    const cost_t prepared = measured_prepare();
    const cost_t fed = measured_feedback();
    uint32_t words[sizeof u / sizeof(uint32_t)];
    (void)memcpy(words, u, sizeof u);
    image_put('S');
    put_cost(prepared, 1);
    put_cost(fed, 1);
    for (unsigned i = 0; i < sizeof words / sizeof words[0]; i++) {
        put_word(words[i]);
    }
    image_put('\n');
}

int main(void)
{
    image_put('E');
    put_cost(measured_nothing(), 0);
    image_put('\n');
    image_put('I');
    put_cost(measured_init(), 1);
    image_put('\n');
    for (int k = 0; k < SAMPLES; k++) {
        sample(k);
    }
    put_other(0, measured_step());
#if HAS_MODEL
    put_other(1, measured_cost());
    put_other(2, measured_integrate());
    put_other(3, measured_shift());
    put_other(4, measured_kkt());
#else
    put_other(7, measured_covariance());
#endif
#if HAS_SOLVE
    put_other(6, measured_solve());
#endif
    put_other(5, measured_reset());
    return 0;
}
