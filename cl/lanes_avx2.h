/* Lanes in registers of 256 bits: two per packet of 16. What AVX2 has no instruction for is done by tables.
 *
 * Reciprocals are divisions here: the guesses that the hardware makes of them in this instruction set differ from one
 * maker of processors to the other.
 */
#ifndef LANES_AVX2_H
#define LANES_AVX2_H

#include "lane_order.h"
#include "lane_types.h"

#define NATIVE_LANES

typedef int avx_int8 __attribute__((__vector_size__(32)));
typedef float avx_float8 __attribute__((__vector_size__(32)));
#define INT8_(x) __builtin_astype(x, avx_int8)
#define FLOAT8_(x) __builtin_astype(x, avx_float8)

typedef float8 __attribute__((aligned(4))) stored_float8;

/* An entry of a table of lane_order.h. */
INLINE int8 lane_order(__constant const ulong *table, uint lanes) { return convert_int8(as_uchar8(table[lanes])); }

/* Lane by lane, which is faster than the instruction that gathers: by a tenth on a Zen 3, and it does not depend on
 * what became of that instruction in processors whose gathers leaked secrets. Two offsets leave a vector at a time.
 * Words lie anywhere, whatever was stored there. */
typedef uint __attribute__((aligned(1), may_alias)) loaded_uint;
typedef ulong __attribute__((aligned(1), may_alias)) loaded_ulong;
#define WORD(at, SCALE) (*(__global const loaded_uint *)(bytes + SCALE * (at)))
#define TWO_WORDS(at, SCALE) (*(__global const loaded_ulong *)(bytes + SCALE * (at)))
#define DEFINE_GATHER(SCALE)                                                                                          \
  INLINE uint16 gather##SCALE(__global const void *base, int16 offset)                                                \
  {                                                                                                                   \
    __global const uchar *bytes = (__global const uchar *)base;                                                       \
    const long8 l = as_long8(offset);                                                                                 \
    return (uint16)(                                                                                                  \
      WORD(l.s0 << 32 >> 32, SCALE), WORD(l.s0 >> 32, SCALE), WORD(l.s1 << 32 >> 32, SCALE), WORD(l.s1 >> 32, SCALE), \
      WORD(l.s2 << 32 >> 32, SCALE), WORD(l.s2 >> 32, SCALE), WORD(l.s3 << 32 >> 32, SCALE), WORD(l.s3 >> 32, SCALE), \
      WORD(l.s4 << 32 >> 32, SCALE), WORD(l.s4 >> 32, SCALE), WORD(l.s5 << 32 >> 32, SCALE), WORD(l.s5 >> 32, SCALE), \
      WORD(l.s6 << 32 >> 32, SCALE), WORD(l.s6 >> 32, SCALE), WORD(l.s7 << 32 >> 32, SCALE), WORD(l.s7 >> 32, SCALE));\
  }
#define DEFINE_GATHER_TWO(SCALE)                                                                                      \
  INLINE void gather_two##SCALE(__global const void *base, int16 offset, uint16 *low, uint16 *high)                   \
  {                                                                                                                   \
    __global const uchar *bytes = (__global const uchar *)base;                                                       \
    const long8 l = as_long8(offset);                                                                                 \
    const uint16 a = as_uint16((ulong8)(                                                                              \
      TWO_WORDS(l.s0 << 32 >> 32, SCALE), TWO_WORDS(l.s0 >> 32, SCALE),                                               \
      TWO_WORDS(l.s1 << 32 >> 32, SCALE), TWO_WORDS(l.s1 >> 32, SCALE),                                               \
      TWO_WORDS(l.s2 << 32 >> 32, SCALE), TWO_WORDS(l.s2 >> 32, SCALE),                                               \
      TWO_WORDS(l.s3 << 32 >> 32, SCALE), TWO_WORDS(l.s3 >> 32, SCALE)));                                             \
    const uint16 b = as_uint16((ulong8)(                                                                              \
      TWO_WORDS(l.s4 << 32 >> 32, SCALE), TWO_WORDS(l.s4 >> 32, SCALE),                                               \
      TWO_WORDS(l.s5 << 32 >> 32, SCALE), TWO_WORDS(l.s5 >> 32, SCALE),                                               \
      TWO_WORDS(l.s6 << 32 >> 32, SCALE), TWO_WORDS(l.s6 >> 32, SCALE),                                               \
      TWO_WORDS(l.s7 << 32 >> 32, SCALE), TWO_WORDS(l.s7 >> 32, SCALE)));                                             \
    *low = (uint16)(a.even, b.even), *high = (uint16)(a.odd, b.odd);                                                  \
  }

INLINE floatN lane_reciprocal(floatN x) { return 1.0f / x; }
INLINE floatN rough_reciprocal(floatN x) { return 1.0f / x; }

INLINE uint bits_of8(int8 mask) { return (uint)__builtin_ia32_movmskps256(FLOAT8_(mask)); }

INLINE int any_lane(intN mask) { return bits_of8(mask.lo | mask.hi) != 0; }

INLINE uint lane_bits(intN mask) { return bits_of8(mask.lo) | bits_of8(mask.hi) << 8; }

INLINE intN lanes_of(uint bits) { return ((intN)(int)bits & ((intN)1 << LANE_INDEX)) != 0; }

/* v at the lanes `at` (0 .. 7). */
INLINE float8 permuted8(float8 v, int8 at)
{
  return __builtin_astype(__builtin_ia32_permvarsf256(FLOAT8_(v), INT8_(at)), float8);
}

INLINE float16 permuted_lanes8(__global const float *table, int16 at)
{
  const float8 v = vload8(0, table);
  return (float16)(permuted8(v, at.lo), permuted8(v, at.hi));
}

/* The lanes in `bits` one after the other at `to`, which has room for 16; what is behind them is undefined. */
INLINE void pack_lanes(float16 v, uint bits, __private float *to)
{
  *(__private stored_float8 *)to = permuted8(v.lo, lane_order(lanes_in_order, bits & 255u));
  to += popcount(bits & 255u);
  *(__private stored_float8 *)to = permuted8(v.hi, lane_order(lanes_in_order, bits >> 8 & 255u));
}

/* The reverse: the lanes in `bits` from one after the other at `from`, where 16 can be read; the others are 0. */
INLINE float16 unpack_lanes(__private const float *from, uint bits)
{
  const float8 low = permuted8(vload8(0, from), lane_order(places_in_order, bits & 255u));
  from += popcount(bits & 255u);
  const float8 high = permuted8(vload8(0, from), lane_order(places_in_order, bits >> 8 & 255u));
  return as_float16(as_int16((float16)(low, high)) & lanes_of(bits));
}

INLINE float16 permuted_lanes(float16 v, int16 at)
{
  const int16 high = at << 28; /* select() looks at the uppermost bit */
  return (float16)(select(permuted8(v.lo, at.lo), permuted8(v.hi, at.lo), high.lo),
                   select(permuted8(v.lo, at.hi), permuted8(v.hi, at.hi), high.hi));
}

#endif
