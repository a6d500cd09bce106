#include "math/constants.c"

#include "math/large_angle.c"

#include "math/scalar.c"

#include "math/functions.c"

#include "math/remainder.c"
