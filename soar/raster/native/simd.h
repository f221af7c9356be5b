// Eight-lane vectors from the extension that GCC and Clang share.
//
// Eight lanes fill one AVX2 register and two NEON registers. Wider vectors are split badly by compilers that target
// AVX2, so the width is fixed. Intrinsics appear only where the generic spelling compiles to poor code.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

#if defined(__AVX2__)
#include <immintrin.h>
#endif

#define SOAR_INLINE static inline __attribute__((always_inline))

namespace soar {

constexpr int kLanes = 8;
typedef float f8 __attribute__((vector_size(32)));
typedef int32_t i8 __attribute__((vector_size(32)));
typedef float f8_unaligned __attribute__((vector_size(32), aligned(4), may_alias));
typedef float f4_unaligned __attribute__((vector_size(16), aligned(4), may_alias));

SOAR_INLINE f8 splat(float x) { return f8{x, x, x, x, x, x, x, x}; }
SOAR_INLINE i8 splat_int(int32_t x) { return i8{x, x, x, x, x, x, x, x}; }
SOAR_INLINE f8 load(const float* p) { return *reinterpret_cast<const f8_unaligned*>(p); }
SOAR_INLINE void store(float* p, f8 v) { *reinterpret_cast<f8_unaligned*>(p) = v; }
SOAR_INLINE f8 as_float(i8 v) { return reinterpret_cast<f8>(v); }
SOAR_INLINE i8 as_int(f8 v) { return reinterpret_cast<i8>(v); }
SOAR_INLINE f8 keep(i8 mask, f8 v) { return as_float(mask & as_int(v)); }  // v where the mask is set, else 0
SOAR_INLINE f8 select(i8 mask, f8 yes, f8 no) { return mask ? yes : no; }
SOAR_INLINE f8 absolute(f8 v) { return as_float(as_int(v) & splat_int(0x7fffffff)); }

#if defined(__AVX2__)
SOAR_INLINE f8 minimum(f8 a, f8 b) { return reinterpret_cast<f8>(_mm256_min_ps((__m256)a, (__m256)b)); }
SOAR_INLINE f8 maximum(f8 a, f8 b) { return reinterpret_cast<f8>(_mm256_max_ps((__m256)a, (__m256)b)); }
SOAR_INLINE f8 square_root(f8 v) { return reinterpret_cast<f8>(_mm256_sqrt_ps((__m256)v)); }
SOAR_INLINE f8 floor(f8 v) { return reinterpret_cast<f8>(_mm256_floor_ps((__m256)v)); }
SOAR_INLINE i8 to_int(f8 v) { return reinterpret_cast<i8>(_mm256_cvttps_epi32((__m256)v)); }
SOAR_INLINE unsigned bits(i8 mask) { return (unsigned)_mm256_movemask_ps((__m256)mask); }
#else
SOAR_INLINE f8 minimum(f8 a, f8 b) { return select(a < b, a, b); }
SOAR_INLINE f8 maximum(f8 a, f8 b) { return select(a > b, a, b); }
SOAR_INLINE f8 square_root(f8 v) {
  for (int i = 0; i < kLanes; ++i) v[i] = std::sqrt(v[i]);
  return v;
}
SOAR_INLINE f8 floor(f8 v) {
  for (int i = 0; i < kLanes; ++i) v[i] = std::floor(v[i]);
  return v;
}
SOAR_INLINE i8 to_int(f8 v) { return __builtin_convertvector(v, i8); }
SOAR_INLINE unsigned bits(i8 mask) {
  unsigned out = 0;
  for (int i = 0; i < kLanes; ++i) out |= (unsigned)(mask[i] < 0) << i;
  return out;
}
#endif

// Lanes of v in the order of eight constants; lanes of a and b likewise, b's counting from 8.
#if defined(__clang__) || __GNUC__ >= 12
#define SOAR_SHUFFLE(v, ...) __builtin_shufflevector(v, v, __VA_ARGS__)
#define SOAR_SHUFFLE2(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define SOAR_SHUFFLE(v, ...) __builtin_shuffle(v, ::soar::i8{__VA_ARGS__})
#define SOAR_SHUFFLE2(a, b, ...) __builtin_shuffle(a, b, ::soar::i8{__VA_ARGS__})
#endif
SOAR_INLINE f8 twice_low(f8 v) { return SOAR_SHUFFLE(v, 0, 0, 1, 1, 2, 2, 3, 3); }
SOAR_INLINE f8 twice_high(f8 v) { return SOAR_SHUFFLE(v, 4, 4, 5, 5, 6, 6, 7, 7); }

// Eight lanes in memory, to be taken from there one by one: load ports are idle where shuffle ports are not, but a
// compiler that sees the store turns the loads into shuffles. The empty assembly keeps it from looking.
template <class T>
struct Spilled {
  T lane[kLanes];
};
SOAR_INLINE Spilled<float> spill(f8 v) {
  Spilled<float> out;
  std::memcpy(out.lane, &v, sizeof v);
  __asm__("" : "+m"(out));
  return out;
}
SOAR_INLINE Spilled<uint32_t> spill(i8 v) {
  Spilled<uint32_t> out;
  std::memcpy(out.lane, &v, sizeof v);
  __asm__("" : "+m"(out));
  return out;
}

// 2^x for x in [-126, 126], relative error below 2e-7. Adding 1.5 * 2^23 rounds to the nearest integer; a compiler
// allowed to reassociate deletes that, which is why the library is never built with -ffast-math.
SOAR_INLINE f8 exp2(f8 x) {
  const f8 magic = splat(12582912.0f);
  const f8 shifted = x + magic;
  const f8 f = x - (shifted - magic);  // in [-0.5, 0.5]
  f8 p = splat(1.32647269e-3f);        // minimax coefficients of 2^f
  p = p * f + splat(9.671512661e-3f);
  p = p * f + splat(5.550733744e-2f);
  p = p * f + splat(2.402224208e-1f);
  p = p * f + splat(6.931469776e-1f);
  p = p * f + splat(1.0f);
  return as_float(as_int(p) + (as_int(shifted) << 23));
}

// An upper bound of log2(x), at most 0.012 above it, for normal x > 0: sizes footprints, never values.
SOAR_INLINE f8 log2_above(f8 x) {
  const i8 i = as_int(x);
  const f8 mantissa = as_float((i & splat_int(0x007fffff)) | splat_int(0x3f800000));
  const f8 exponent = __builtin_convertvector((i >> 23) - splat_int(127), f8);
  return exponent + (splat(-0.33582878f) * mantissa + splat(2.0f)) * mantissa + splat(-1.65871f + 0.006f);
}

}  // namespace soar
