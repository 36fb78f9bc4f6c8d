/* Lanes in registers of 512 bits, one per packet, and what AVX-512 has an instruction for. */
#ifndef LANES_AVX512_H
#define LANES_AVX512_H

#include "lane_types.h"

#define NATIVE_LANES

typedef int gather_int16 __attribute__((__vector_size__(64)));
typedef float gather_float16 __attribute__((__vector_size__(64)));
#define DEFINE_GATHER(SCALE)                                                                              \
  INLINE uint16 gather##SCALE(__global const void *base, int16 offset)                                    \
  {                                                                                                       \
    return __builtin_astype(                                                                              \
      __builtin_ia32_gathersiv16si(__builtin_astype((int16)0, gather_int16), (const void *)(size_t)base,  \
                                   __builtin_astype(offset, gather_int16), (ushort)0xffff, SCALE),        \
      uint16);                                                                                            \
  }
/* Two words per lane, at byte B * offset and 4 after it: the hardware takes as long for 64 bits as for 32. */
typedef long gather_long8 __attribute__((__vector_size__(64)));
typedef int gather_int8 __attribute__((__vector_size__(32)));
#define GATHER_LONGS(base, offset, SCALE)                                                                  \
  __builtin_astype(__builtin_ia32_gathersiv8di(none, (const void *)(size_t)(base),                         \
                                               __builtin_astype(offset, gather_int8), (uchar)0xff, SCALE), \
                   uint16)
#define DEFINE_GATHER_TWO(SCALE)                                                                                   \
  INLINE void gather_two##SCALE(__global const void *base, int16 offset, uint16 *low, uint16 *high)                \
  {                                                                                                                \
    const gather_long8 none = {0, 0, 0, 0, 0, 0, 0, 0};                                                            \
    const uint16 a = GATHER_LONGS(base, offset.lo, SCALE), b = GATHER_LONGS(base, offset.hi, SCALE);               \
    *low = (uint16)(a.even, b.even), *high = (uint16)(a.odd, b.odd);                                               \
  }
/* 1 / x for normal x, to 2e-8 or so: the hardware's guess of 14 bits and one of Newton's steps. */
INLINE floatN lane_reciprocal(floatN x)
{
  const float16 y = __builtin_astype(__builtin_ia32_rcp14ps512_mask(__builtin_astype(x, gather_float16),
                                                                    __builtin_astype(x, gather_float16),
                                                                        (ushort)0xffff), float16);
  return y * (2.0f - x * y);
}
/* 1 / x for normal x, to 6e-5. */
INLINE floatN rough_reciprocal(floatN x)
{
  return __builtin_astype(__builtin_ia32_rcp14ps512_mask(__builtin_astype(x, gather_float16),
                                                         __builtin_astype(x, gather_float16),
                                                         (ushort)0xffff), float16);
}

INLINE int any_lane(intN mask)
{
  return __builtin_ia32_cvtd2mask512(__builtin_astype(mask, gather_int16)) != 0;
}

INLINE uint lane_bits(intN mask) { return (ushort)__builtin_ia32_cvtd2mask512(__builtin_astype(mask, gather_int16)); }

INLINE intN lanes_of(uint bits) { return __builtin_astype(__builtin_ia32_cvtmask2d512((ushort)bits), int16); }

INLINE void pack_lanes(float16 v, uint bits, __private float *to)
{
  store_lanes(__builtin_astype(__builtin_ia32_compresssf512_mask(__builtin_astype(v, gather_float16),
                                                                 __builtin_astype((float16)0.0f, gather_float16),
                                                                 (ushort)bits), float16), to);
}

INLINE float16 unpack_lanes(__private const float *from, uint bits)
{
  return __builtin_astype(__builtin_ia32_expandsf512_mask(__builtin_astype(vload16(0, from), gather_float16),
                                                          __builtin_astype((float16)0.0f, gather_float16),
                                                          (ushort)bits), float16);
}

INLINE float16 permuted_lanes(float16 v, int16 at)
{
  return __builtin_astype(__builtin_ia32_permvarsf512(__builtin_astype(v, gather_float16),
                                                      __builtin_astype(at, gather_int16)), float16);
}

INLINE float16 permuted_lanes8(__global const float *table, int16 at) { return permuted_lanes(vload16(0, table), at); }

/* The hardware's guess of 1 / sqrt(x), of 14 bits. */
#define GUESSED_RSQRT(x) \
  __builtin_astype(__builtin_ia32_rsqrt14ps512_mask(__builtin_astype(x, gather_float16), \
                                                    __builtin_astype(x, gather_float16), (ushort)0xffff), float16)

/* table[at] for each lane, from vector registers: fewer instructions than a gather up to some hundred entries. `at` in
 * 0 .. 31, and so on. */
#define TABLES_IN_REGISTERS
INLINE float16 permuted_lanes32(__global const float *table, int16 at)
{
  return __builtin_astype(
    __builtin_ia32_vpermi2varps512(__builtin_astype(vload16(0, table), gather_float16),
                                   __builtin_astype(at, gather_int16),
                                   __builtin_astype(vload16(1, table), gather_float16)), float16);
}
INLINE float16 permuted_lanes64(__global const float *table, int16 at)
{
  return select(permuted_lanes32(table, at), permuted_lanes32(table + 32, at), MASK(at >= 32));
}
INLINE float16 permuted_lanes128(__global const float *table, int16 at)
{
  const int16 half_ = at & 63;
  return select(permuted_lanes64(table, half_), permuted_lanes64(table + 64, half_), MASK(at >= 64));
}
INLINE float16 permuted_lanes256(__global const float *table, int16 at)
{
  const int16 half_ = at & 127;
  return select(permuted_lanes128(table, half_), permuted_lanes128(table + 128, half_), MASK(at >= 128));
}

#endif
