/* A packet of rays, one ray per lane: what can be done with lanes beside arithmetic. */
#ifndef LANES_H
#define LANES_H

#include "lane_types.h"

/* What processors differ in. Each of these headers defines
 *   gatherB         for each lane the 32-bit word at byte B * offset from base (unaligned). The hardware's gather takes a
 *                   signed 32-bit index and a scale, which is what a plain C loop does not compile to: clang widens the
 *                   index first and gathers half as many lanes at a time.
 *   gather_twoB     two words per lane, at byte B * offset and 4 after it
 *   lane_reciprocal, rough_reciprocal   1 / x for normal x, to 2e-8 or so, and to 6e-5
 *   any_lane        whether a mask has any lane set. PoCL's any() tests lane after lane.
 *   lane_bits, lanes_of   which lanes are set, as bits; and the mask that has them
 * and for packets of 16
 *   pack_lanes      the lanes in `bits` one after the other at `to`, which has room for 16; what is behind them is
 *                   undefined
 *   unpack_lanes    the reverse: the lanes in `bits` from one after the other at `from`, where 16 can be read; the others
 *                   are 0
 *   permuted_lanes  v at the lanes `at`, whose lowest four bits count
 *   permuted_lanes8   table[at] for each lane, `at` in 0 .. 7, where 16 can be read
 * NATIVE_LANES says that packing, unpacking and permuting take a few instructions, and that gathers read wherever a word
 * lies; TABLES_IN_REGISTERS that permuted_lanes32 to permuted_lanes256 look longer tables up in registers.
 *
 * For tests, -D LANES_IN_AVX2 and -D LANES_PORTABLE choose a header whatever the processor has.
 */
#if LANES == 16 && defined(__has_builtin) && !defined(LANES_IN_AVX2) && !defined(LANES_PORTABLE)
#if defined(__AVX512F__) && defined(__AVX512DQ__)
#if __has_builtin(__builtin_ia32_gathersiv16si) && __has_builtin(__builtin_ia32_cvtmask2d512) && \
  __has_builtin(__builtin_ia32_compresssf512_mask) && __has_builtin(__builtin_ia32_vpermi2varps512)
#define LANES_IN_AVX512
#endif
#elif defined(__AVX2__)
#if __has_builtin(__builtin_ia32_gatherd_d256) && __has_builtin(__builtin_ia32_permvarsf256)
#define LANES_IN_AVX2
#endif
#endif
#endif

#ifdef LANES_IN_AVX512
#include "lanes_avx512.h"
#elif defined(LANES_IN_AVX2)
#include "lanes_avx2.h"
#else
#include "lanes_portable.h"
#endif

DEFINE_GATHER(1)
DEFINE_GATHER(2)
DEFINE_GATHER(4)
DEFINE_GATHER_TWO(2)
DEFINE_GATHER_TWO(4)

/* min, max and clamp that compile to one instruction each: OpenCL's own look for NaN first on PoCL. With a NaN the
 * result is b. */
#define LANE_MIN(a, b) select((b), (a), MASK((a) < (b)))
#define LANE_MAX(a, b) select((b), (a), MASK((a) > (b)))
INLINE floatN lane_min(floatN a, floatN b) { return LANE_MIN(a, b); }
INLINE floatN lane_max(floatN a, floatN b) { return LANE_MAX(a, b); }
INLINE floatN lane_clamp(floatN x, floatN low, floatN high) { return lane_min(lane_max(x, low), high); }

/* Neither NaN nor infinite. */
INLINE intN finite_lanes(floatN v) { return MASK((AS_INT(v) & 0x7f800000) != 0x7f800000); }

/* The least of all lanes. */
INLINE int least_lane(intN v)
{
#if LANES == 16
  const int8 a = min(v.lo, v.hi);
  const int4 b = min(a.lo, a.hi);
  const int2 c = min(b.lo, b.hi);
  return min(c.x, c.y);
#else
  return v;
#endif
}

/* 1 / sqrt(x) for normal x > 0, to 3e-7: the hardware's guess of 14 bits where there is one, else one from the
 * exponent, then Newton's steps. Packets' square roots and divisions take many times as long. */
INLINE floatN lane_rsqrt(floatN x)
{
  const floatN halved = 0.5f * x;
#if LANES == 1
  return rsqrt(x);
#else
#ifdef GUESSED_RSQRT
  floatN y = GUESSED_RSQRT(x);
#else
  floatN y = AS_FLOAT(0x5f375a86 - (AS_INT(x) >> 1));
  y *= 1.5f - halved * y * y;
  y *= 1.5f - halved * y * y;
#endif
  y *= 1.5f - halved * y * y;
  return y;
#endif
}

#if LANES == 16
/* from[at] for each lane: what a work-item keeps in its own memory. */
INLINE float16 gather_private(__private const float *from, int16 at)
{
#ifdef NATIVE_LANES
  return as_float16(gather4((__global const void *)(size_t)from, at));
#else
  float each[16];
  int lane[16];
  vstore16(at, 0, lane);
  EACH_LANE(k) each[k] = from[lane[k]];
  return vload16(0, each);
#endif
}
#endif

#endif
