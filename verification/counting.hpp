// A real number that counts its operations: the generated .c is compiled as C++ with it in place of double or float.
// Classes as in nmpc_codegen.kernel.OpCount; conversions, stores and copies cost nothing.
#ifndef COUNTING_HPP
#define COUNTING_HPP

#include <math.h>

struct counted {
    double value;

    static long add, mul, div, sqrt, call, other;
    static void reset() { add = mul = div = sqrt = call = other = 0; }

    counted() = default;
    counted(double v) : value(v) {}
    explicit operator double() const { return value; }
    explicit operator int() const { return (int)value; }

    counted &operator+=(counted b) { ++add; value += b.value; return *this; }
    counted &operator-=(counted b) { ++add; value -= b.value; return *this; }
    counted &operator*=(counted b) { ++mul; value *= b.value; return *this; }
    counted &operator/=(counted b) { ++div; value /= b.value; return *this; }
    counted operator-() const { ++other; return counted(-value); }

    friend counted operator+(counted a, counted b) { ++add; return counted(a.value + b.value); }
    friend counted operator-(counted a, counted b) { ++add; return counted(a.value - b.value); }
    friend counted operator*(counted a, counted b) { ++mul; return counted(a.value * b.value); }
    friend counted operator/(counted a, counted b) { ++div; return counted(a.value / b.value); }
    friend bool operator<(counted a, counted b) { ++other; return a.value < b.value; }
    friend bool operator>(counted a, counted b) { ++other; return a.value > b.value; }
    friend bool operator<=(counted a, counted b) { ++other; return a.value <= b.value; }
    friend bool operator>=(counted a, counted b) { ++other; return a.value >= b.value; }
    friend bool operator==(counted a, counted b) { ++other; return a.value == b.value; }
    friend bool operator!=(counted a, counted b) { ++other; return a.value != b.value; }
};

long counted::add = 0, counted::mul = 0, counted::div = 0, counted::sqrt = 0, counted::call = 0, counted::other = 0;

static inline bool isfinite(counted a) { return ::isfinite(a.value) != 0; }

#define COUNTED_1(kind, name) \
    static inline counted name(counted a) { ++counted::kind; return counted(::name(a.value)); } \
    static inline counted name##f(counted a) { ++counted::kind; return counted(::name(a.value)); }
#define COUNTED_2(kind, name) \
    static inline counted name(counted a, counted b) { ++counted::kind; return counted(::name(a.value, b.value)); } \
    static inline counted name##f(counted a, counted b) { ++counted::kind; return counted(::name(a.value, b.value)); }

COUNTED_1(sqrt, sqrt)
COUNTED_1(call, exp)
COUNTED_1(call, expm1)
COUNTED_1(call, log)
COUNTED_1(call, log1p)
COUNTED_2(call, pow)
COUNTED_1(call, sin)
COUNTED_1(call, cos)
COUNTED_1(call, tan)
COUNTED_1(call, asin)
COUNTED_1(call, acos)
COUNTED_1(call, atan)
COUNTED_2(call, atan2)
COUNTED_1(call, sinh)
COUNTED_1(call, cosh)
COUNTED_1(call, tanh)
COUNTED_1(call, asinh)
COUNTED_1(call, acosh)
COUNTED_1(call, atanh)
COUNTED_1(call, erf)
COUNTED_2(call, hypot)
COUNTED_2(call, fmod)
COUNTED_2(call, remainder)
COUNTED_1(other, fabs)
COUNTED_1(other, floor)
COUNTED_1(other, ceil)
COUNTED_2(other, fmin)
COUNTED_2(other, fmax)
COUNTED_2(other, copysign)

#endif
