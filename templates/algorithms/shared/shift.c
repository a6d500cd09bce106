#if SHIFT_RESAMPLE
#include "algorithms/shared/shift_resample.c"
#else
#include "algorithms/shared/shift_by_one.c"

#if SHIFT_PERIODIC
#include "algorithms/shared/shift_periodic.c"
#else
#include "algorithms/shared/shift_repeat.c"
#endif
#endif

status_t API(shift)(solver_t *s)
{
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    shift_plan(s);
    s->prepared = 0;
    s->solved = 0;
    return OK;
}
