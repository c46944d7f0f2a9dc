// Arithmetic on a few contacts at once: a lane holds one contact, and one vector instruction works on all lanes.
//
// Compilers without GNU's vector types, and -DJAXGRASP_LANES=1, use plain numbers: one lane, the same code.
#ifndef JAXGRASP_KERNEL_LANES_H
#define JAXGRASP_KERNEL_LANES_H

#include "platform.h"

// Clang as a library, as NVIDIA Warp has it, does not say that it is GNU's.
#if defined(__GNUC__) || defined(__clang__)
#define JAXGRASP_HAS_VECTORS 1
#else
#define JAXGRASP_HAS_VECTORS 0
#endif

// Eight lanes, where a processor has them, were no faster.
#ifndef JAXGRASP_LANES
#if defined(__CUDACC__)
#define JAXGRASP_LANES 1
#elif JAXGRASP_HAS_VECTORS && defined(__AVX__)
#define JAXGRASP_LANES 4
#elif JAXGRASP_HAS_VECTORS && (defined(__SSE2__) || defined(__aarch64__))
#define JAXGRASP_LANES 2
#else
#define JAXGRASP_LANES 1
#endif
#endif

#if defined(__has_builtin)
#if __has_builtin(__builtin_elementwise_sqrt)
#define JAXGRASP_HAS_VECTOR_SQRT 1
#endif
#if __has_builtin(__builtin_shufflevector)
#define JAXGRASP_HAS_SHUFFLE 1
#endif
#endif

// Functions that stay functions: what is inlined everywhere takes a GPU's compiler minutes.
#if defined(__CUDACC__)
#define JAXGRASP_OUTLINE __noinline__
#else
#define JAXGRASP_OUTLINE
#endif
#if JAXGRASP_HAS_VECTORS
#define JAXGRASP_INLINE inline __attribute__((always_inline))
#else
#define JAXGRASP_INLINE inline
#endif

namespace jaxgrasp {

#if JAXGRASP_LANES > 1
template <class Real> struct LaneType {
  typedef Real type __attribute__((vector_size(JAXGRASP_LANES * sizeof(Real))));
};
#else
template <class Real> struct LaneType {
  typedef Real type;
};
#endif

// Numbers of JAXGRASP_LANES contacts. Every function here is inlined, so that no such value crosses a call.
template <class Real> using Lanes = typename LaneType<Real>::type;
// Conditions of as many contacts; `&` and `!` combine them.
template <class Real> using Mask = decltype(Lanes<Real>() < Lanes<Real>());

template <class Real> JAXGRASP_INLINE Lanes<Real> all_lanes(Real x) { return Lanes<Real>{} + x; }

template <class Real> JAXGRASP_INLINE Real lane(const Lanes<Real>& x, int i) {
  if constexpr (JAXGRASP_LANES == 1) return (void)i, x;
  else return x[i];
}
template <class Real> JAXGRASP_INLINE void set_lane(Lanes<Real>& x, int i, Real value) {
  if constexpr (JAXGRASP_LANES == 1) (void)i, x = value;
  else x[i] = value;
}

template <class Real> JAXGRASP_INLINE Lanes<Real> square_root(Lanes<Real> x) {
#if JAXGRASP_LANES > 1 && defined(JAXGRASP_HAS_VECTOR_SQRT)
  return __builtin_elementwise_sqrt(x);
#endif
  for (int i = 0; i < JAXGRASP_LANES; i++) set_lane<Real>(x, i, math::sqrt(lane<Real>(x, i)));
  return x;
}

template <class Real> JAXGRASP_INLINE Lanes<Real> magnitude(Lanes<Real> x) { return x < Real(0) ? -x : x; }

// The sum of all lanes: halves are added first, which is fewer instructions and less rounding than one after the other.
template <class Real> JAXGRASP_INLINE Real sum(const Lanes<Real>& x) {
#if JAXGRASP_LANES == 4 && defined(JAXGRASP_HAS_SHUFFLE)
  const auto two = __builtin_shufflevector(x, x, 0, 1) + __builtin_shufflevector(x, x, 2, 3);
  return two[0] + two[1];
#endif
  Real total = lane<Real>(x, 0);
  for (int i = 1; i < JAXGRASP_LANES; i++) total += lane<Real>(x, i);
  return total;
}

template <class Real> JAXGRASP_INLINE Real largest(const Lanes<Real>& x) {
  Real result = lane<Real>(x, 0);
  for (int i = 1; i < JAXGRASP_LANES; i++) result = lane<Real>(x, i) > result ? lane<Real>(x, i) : result;
  return result;
}

template <class Real> JAXGRASP_INLINE bool all_true(Mask<Real> condition) {
  return sum<Real>(condition ? all_lanes(Real(1)) : all_lanes(Real(0))) == Real(JAXGRASP_LANES);
}

}  // namespace jaxgrasp

#endif
