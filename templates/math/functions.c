#include "math/rounding.c"

#include "math/exp.c"

#include "math/log.c"

#include "math/power.c"

#include "math/angles.c"

#include "math/arcs.c"

#include "math/hyperbolic.c"
