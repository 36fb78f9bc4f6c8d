/* Lanes where nothing is known of the processor: loops that compilers may make of what they find, and rays alone. */
#ifndef LANES_PORTABLE_H
#define LANES_PORTABLE_H

#include "lane_types.h"

INLINE floatN lane_reciprocal(floatN x) { return 1.0f / x; }
INLINE floatN rough_reciprocal(floatN x) { return 1.0f / x; }
#define DEFINE_GATHER_TWO(SCALE)                                                                           \
  INLINE void gather_two##SCALE(__global const void *base, intN offset, uintN *low, uintN *high)           \
  {                                                                                                        \
    *low = gather##SCALE(base, offset), *high = gather##SCALE((__global const uchar *)base + 4, offset);   \
  }
#define DEFINE_GATHER(SCALE)                                                                              \
  INLINE uintN gather##SCALE(__global const void *base, intN offset)                                      \
  {                                                                                                       \
    int at[LANES];                                                                                        \
    uint word[LANES];                                                                                     \
    STORE_LANES(offset, at);                                                                              \
    EACH_LANE(k) word[k] = gather_word##SCALE(base, at[k]);                                               \
    return LOAD_LANES(word);                                                                              \
  }
/* Only as aligned as the element is: a GPU faults on, or rounds down, an unaligned 32-bit load. */
INLINE uint gather_word1(__global const void *base, int at)
{
  __global const uchar *b = (__global const uchar *)base + at;
  return b[0] | (uint)b[1] << 8 | (uint)b[2] << 16 | (uint)b[3] << 24;
}
INLINE uint gather_word2(__global const void *base, int at)
{
  __global const ushort *b = (__global const ushort *)base + at;
  return b[0] | (uint)b[1] << 16;
}
INLINE uint gather_word4(__global const void *base, int at) { return ((__global const uint *)base)[at]; }

INLINE int any_lane(intN mask)
{
#if LANES == 16
  const int8 a = mask.lo | mask.hi;
  const int4 b = a.lo | a.hi;
  const int2 c = b.lo | b.hi;
  return (c.x | c.y) < 0;
#else
  return mask;
#endif
}

#if LANES == 16
INLINE uint lane_bits(intN mask)
{
  int each[16];
  uint bits = 0;
  vstore16(mask, 0, each);
  EACH_LANE(k) bits |= ((uint)each[k] >> 31) << k;
  return bits;
}

INLINE intN lanes_of(uint bits) { return MASK(((intN)(int)bits >> LANE_INDEX & 1) != 0); }

INLINE void pack_lanes(float16 v, uint bits, __private float *to)
{
  float each[16];
  vstore16(v, 0, each);
  EACH_LANE(k)
  {
    *to = each[k];
    to += bits >> k & 1u;
  }
}

INLINE float16 unpack_lanes(__private const float *from, uint bits)
{
  float each[16];
  EACH_LANE(k)
  {
    each[k] = bits >> k & 1u ? *from : 0.0f;
    from += bits >> k & 1u;
  }
  return vload16(0, each);
}

INLINE float16 permuted_lanes(float16 v, int16 at) { return shuffle(v, as_uint16(at)); }
INLINE float16 permuted_lanes8(__global const float *table, int16 at) { return shuffle(vload8(0, table), as_uint16(at)); }
#else
INLINE uint lane_bits(intN mask) { return (uint)mask & 1u; }
INLINE intN lanes_of(uint bits) { return -(intN)(bits & 1u); }
#endif

#endif
