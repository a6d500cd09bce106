#if SHIFT_RESAMPLE
#include "algorithms/shift_resample.c"
#else
#include "algorithms/shift_by_one.c"

#if SHIFT_PERIODIC
#include "algorithms/shift_periodic.c"
#else
#include "algorithms/shift_repeat.c"
#endif
#endif

status_t API(shift)(solver_t *s)
{
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    shift_plan(s);
    s->prepared = 0;
    return OK;
}
