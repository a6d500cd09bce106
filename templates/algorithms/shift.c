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

#include "algorithms/drop_rounding.c"

status_t API(shift)(solver_t *s)
{
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    shift_plan(s);
    drop_rounding(s);
    s->prepared = 0;
    return OK;
}
