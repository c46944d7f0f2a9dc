// The few functions of <cmath> and <limits> that the solver needs, with or without the standard library.
//
// NVIDIA Warp compiles without a standard library, on processors by Clang and on GPUs by NVRTC: there they are the
// compiler's own functions.
#ifndef JAXGRASP_KERNEL_PLATFORM_H
#define JAXGRASP_KERNEL_PLATFORM_H

#if defined(WP_NO_CRT)

namespace jaxgrasp {
namespace math {

#if defined(__CUDACC__)
inline double sqrt(double x) { return ::sqrt(x); }
inline float sqrt(float x) { return ::sqrtf(x); }
inline double fabs(double x) { return ::fabs(x); }
inline float fabs(float x) { return ::fabsf(x); }
inline double fma(double a, double b, double c) { return ::fma(a, b, c); }
inline float fma(float a, float b, float c) { return ::fmaf(a, b, c); }
// Products that no compiler joins with a sum whose error is computed.
inline double product(double a, double b) { return __dmul_rn(a, b); }
inline float product(float a, float b) { return __fmul_rn(a, b); }
#else
inline double sqrt(double x) { return __builtin_sqrt(x); }
inline float sqrt(float x) { return __builtin_sqrtf(x); }
inline double fabs(double x) { return __builtin_fabs(x); }
inline float fabs(float x) { return __builtin_fabsf(x); }
inline double fma(double a, double b, double c) { return __builtin_fma(a, b, c); }
inline float fma(float a, float b, float c) { return __builtin_fmaf(a, b, c); }
#endif
template <class Real> inline bool isnan(Real x) { return x != x; }

template <class Real> struct Limits;
template <> struct Limits<double> {
  static constexpr double epsilon = 2.220446049250313e-16, smallest = 2.2250738585072014e-308;
  static constexpr double infinity = __builtin_bit_cast(double, 0x7ff0000000000000ull);
};
template <> struct Limits<float> {
  static constexpr float epsilon = 1.1920929e-7f, smallest = 1.17549435e-38f;
  static constexpr float infinity = __builtin_bit_cast(float, 0x7f800000u);
};

}  // namespace math
}  // namespace jaxgrasp

#else

#include <cmath>
#include <cstring>
#include <limits>

namespace jaxgrasp {
namespace math {

using std::fabs;
using std::fma;
using std::isnan;
using std::memcpy;
using std::sqrt;

template <class Real> struct Limits {
  static constexpr Real epsilon = std::numeric_limits<Real>::epsilon(), smallest = std::numeric_limits<Real>::min();
  static constexpr Real infinity = std::numeric_limits<Real>::infinity();
};

}  // namespace math
}  // namespace jaxgrasp

#endif

#if !(defined(__CUDACC__) && defined(WP_NO_CRT))
namespace jaxgrasp {
namespace math {

// A product that no compiler joins with a sum whose error is computed.
template <class Real> inline Real product(Real a, Real b) {
  volatile Real result = a * b;
  return result;
}

}  // namespace math
}  // namespace jaxgrasp
#endif

namespace jaxgrasp {
namespace math {

// Whether a number, 0 or more, is subnormal: by its bits, since a processor may take such numbers for zero.
inline bool is_subnormal(double x) {
  unsigned long long bits;
  memcpy(&bits, &x, sizeof bits);
  return bits > 0 && bits < 1ull << 52;
}
inline bool is_subnormal(float x) {
  unsigned bits;
  memcpy(&bits, &x, sizeof bits);
  return bits > 0 && bits < 1u << 23;
}

}  // namespace math
}  // namespace jaxgrasp

#endif
