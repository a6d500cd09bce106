/* This part solves the stages of implicit Runge-Kutta schemes, and integrates over an interval with them. */

#include "integrators/implicit/lu.c"

#include "integrators/implicit/newton.c"

#if NALG
#include "integrators/implicit/algebraic.c"
#endif

#include "integrators/implicit/forward.c"

#include "integrators/implicit/adjoint.c"

#include "integrators/implicit/quadrature.c"

#include "integrators/implicit/curvature.c"

/* The functions of an interval follow. */

#include "generated/intervals.c"
