/* tcc 0.9.27 evaluates no minus sign before an infinity in the initial value of a table, but -1.0f / 0.0f. */
#include_next <math.h>
#undef INFINITY
#define INFINITY 1.0f / 0.0f
