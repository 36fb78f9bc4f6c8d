/* A packet of rays, one ray per lane.
 *
 * LANES is 16 where one work-item marches a packet with vector registers (CPU devices), and 1 where a work-item
 * is a ray (GPUs). Masks are all bits set or none in both cases: wrap every comparison in MASK().
 */
#ifndef LANES_H
#define LANES_H

/* For what is called once per packet: a function of its own is a name in profiles, and costs nothing there. */
#if LANES > 1
#define PER_PACKET RARE
#else
#define PER_PACKET INLINE
#endif

#if LANES == 16

typedef float16 floatN;
typedef int16 intN;
typedef uint16 uintN;
#define TO_FLOAT(x) convert_float16(x)
#define TO_INT(x) convert_int16(x)
#define AS_INT(x) as_int16(x)
#define AS_FLOAT(x) as_float16(x)
#define AS_UINT(x) as_uint16(x)
#define MASK(c) (c)
#define LANE_INDEX ((int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15))
#define PACKET_W 4
#define PACKET_H 4
#define EACH_LANE(k) for (int k = 0; k < 16; ++k)
#define STORE_LANES(v, a) store_lanes(v, a)
#define LOAD_LANES(a) vload16(0, a)

#elif LANES == 1

typedef float floatN;
typedef int intN;
typedef uint uintN;
#define TO_FLOAT(x) convert_float(x)
#define TO_INT(x) convert_int(x)
#define AS_INT(x) as_int(x)
#define AS_FLOAT(x) as_float(x)
#define AS_UINT(x) as_uint(x)
#define MASK(c) (-(c))
#define LANE_INDEX 0
#define PACKET_W 1
#define PACKET_H 1
#define EACH_LANE(k) for (int k = 0; k < 1; ++k)
#define STORE_LANES(v, a) ((a)[0] = (v))
#define LOAD_LANES(a) ((a)[0])

#else
#error "LANES must be 1 or 16"
#endif

/* For a loop over a few values that an array holds: a packet's array lies in the cache, one ray's in registers, where
 * nothing indexes it. */
#if LANES == 1
#define UNROLL_LANES _Pragma("unroll")
#else
#define UNROLL_LANES _Pragma("unroll 1")
#endif

/* Lane by lane where it is rare: unrolled, such loops take compilers many seconds. */
#define EACH_LANE_ROLLED(k) _Pragma("unroll 1") EACH_LANE(k)

/* For what is large and rare: inlined everywhere it would take compilers minutes. */
#define RARE __attribute__((noinline))

/* A call in the inner loop would spill every ray of the packet. */
#define INLINE inline __attribute__((always_inline))

#if LANES == 16
/* As vstore16, which PoCL's compiler cuts into three stores. */
typedef float16 stored_float16 __attribute__((aligned(4)));
typedef int16 stored_int16 __attribute__((aligned(4)));
typedef uint16 stored_uint16 __attribute__((aligned(4)));
INLINE void __attribute__((overloadable)) store_lanes(float16 v,
                                                      __private float *a) { *(__private stored_float16 *)a = v; }
INLINE void __attribute__((overloadable)) store_lanes(int16 v, __private int *a) { *(__private stored_int16 *)a = v; }
INLINE void __attribute__((overloadable)) store_lanes(uint16 v,
                                                      __private uint *a) { *(__private stored_uint16 *)a = v; }
INLINE void __attribute__((overloadable)) store_lanes(float16 v, __global float *a) { vstore16(v, 0, a); }
INLINE void __attribute__((overloadable)) store_lanes(int16 v, __global int *a) { vstore16(v, 0, a); }
INLINE void __attribute__((overloadable)) store_lanes(uint16 v, __global uint *a) { vstore16(v, 0, a); }
#endif

/* Without this attribute LLVM's x86 back end splits 512-bit vectors in two halves. */
#if defined(__has_attribute)
#if __has_attribute(min_vector_width)
#define WIDE_VECTORS __attribute__((min_vector_width(512)))
#endif
#endif
#ifndef WIDE_VECTORS
#define WIDE_VECTORS
#endif

/* gatherB: for each lane the 32-bit word at byte B * offset from base (unaligned). The hardware's gather takes a signed
 * 32-bit index and a scale, which is what a plain C loop does not compile to: clang widens the index first and gathers
 * half as many lanes at a time. Elsewhere the loop is right.
 */
#if LANES == 16 && defined(__AVX512F__) && defined(__has_builtin)
#if __has_builtin(__builtin_ia32_gathersiv16si)
#define HARDWARE_GATHER
#endif
#endif

#ifdef HARDWARE_GATHER
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
#else
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
#endif

/* min, max and clamp that compile to one instruction each: OpenCL's own look for NaN first on PoCL. With a NaN the
 * result is b. */
#define LANE_MIN(a, b) select((b), (a), MASK((a) < (b)))
#define LANE_MAX(a, b) select((b), (a), MASK((a) > (b)))
INLINE floatN lane_min(floatN a, floatN b) { return LANE_MIN(a, b); }
INLINE floatN lane_max(floatN a, floatN b) { return LANE_MAX(a, b); }
INLINE floatN lane_clamp(floatN x, floatN low, floatN high) { return lane_min(lane_max(x, low), high); }

/* Neither NaN nor infinite. */
INLINE intN finite_lanes(floatN v) { return MASK((AS_INT(v) & 0x7f800000) != 0x7f800000); }

/* Whether a mask has any lane set. PoCL's any() tests lane after lane. */
INLINE int any_lane(intN mask)
{
#if defined(HARDWARE_GATHER) && defined(__AVX512DQ__)
  return __builtin_ia32_cvtd2mask512(__builtin_astype(mask, gather_int16)) != 0;
#elif LANES == 16
  const int8 a = mask.lo | mask.hi;
  const int4 b = a.lo | a.hi;
  const int2 c = b.lo | b.hi;
  return (c.x | c.y) < 0;
#else
  return mask;
#endif
}

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
#if defined(HARDWARE_GATHER) && __has_builtin(__builtin_ia32_rsqrt14ps512_mask)
  floatN y = __builtin_astype(__builtin_ia32_rsqrt14ps512_mask(__builtin_astype(x, gather_float16),
                                                               __builtin_astype(x, gather_float16), (ushort)0xffff),
                                                                   float16);
#else
  floatN y = AS_FLOAT(0x5f375a86 - (AS_INT(x) >> 1));
  y *= 1.5f - halved * y * y;
  y *= 1.5f - halved * y * y;
#endif
  y *= 1.5f - halved * y * y;
  return y;
#endif
}

DEFINE_GATHER(1)
DEFINE_GATHER(2)
DEFINE_GATHER(4)
DEFINE_GATHER_TWO(2)
DEFINE_GATHER_TWO(4)

#if LANES == 16
/* Which lanes are set, as bits. */
INLINE uint lane_bits(intN mask)
{
#if defined(HARDWARE_GATHER) && defined(__AVX512DQ__)
  return (ushort)__builtin_ia32_cvtd2mask512(__builtin_astype(mask, gather_int16));
#else
  int each[16];
  uint bits = 0;
  vstore16(mask, 0, each);
  EACH_LANE(k) bits |= ((uint)each[k] >> 31) << k;
  return bits;
#endif
}

/* The mask that has the lanes in `bits`. */
INLINE intN lanes_of(uint bits)
{
#if defined(HARDWARE_GATHER) && defined(__AVX512DQ__) && __has_builtin(__builtin_ia32_cvtmask2d512)
  return __builtin_astype(__builtin_ia32_cvtmask2d512((ushort)bits), int16);
#else
  return MASK(((intN)(int)bits >> LANE_INDEX & 1) != 0);
#endif
}

/* The lanes in `bits` one after the other at `to`, which has room for 16; what is behind them is undefined. */
INLINE void pack_lanes(float16 v, uint bits, float *to)
{
#if defined(HARDWARE_GATHER) && __has_builtin(__builtin_ia32_compresssf512_mask)
  store_lanes(__builtin_astype(__builtin_ia32_compresssf512_mask(__builtin_astype(v, gather_float16),
                                                              __builtin_astype((float16)0.0f, gather_float16),
                                                                  (ushort)bits),
                            float16), to);
#else
  float each[16];
  vstore16(v, 0, each);
  EACH_LANE(k)
  {
    *to = each[k];
    to += bits >> k & 1u;
  }
#endif
}

/* The reverse: the lanes in `bits` from one after the other at `from`, where 16 can be read; the others are 0. */
INLINE float16 unpack_lanes(__private const float *from, uint bits)
{
#if defined(HARDWARE_GATHER) && __has_builtin(__builtin_ia32_expandsf512_mask)
  return __builtin_astype(__builtin_ia32_expandsf512_mask(__builtin_astype(vload16(0, from), gather_float16),
                                                          __builtin_astype((float16)0.0f, gather_float16),
                                                              (ushort)bits),
                          float16);
#else
  float each[16];
  EACH_LANE(k)
  {
    each[k] = bits >> k & 1u ? *from : 0.0f;
    from += bits >> k & 1u;
  }
  return vload16(0, each);
#endif
}

/* from[at] for each lane: what a work-item keeps in its own memory. */
INLINE float16 gather_private(__private const float *from, int16 at)
{
#ifdef HARDWARE_GATHER
  return as_float16(gather4((__global const void *)(size_t)from, at));
#else
  float each[16];
  int lane[16];
  vstore16(at, 0, lane);
  EACH_LANE(k) each[k] = from[lane[k]];
  return vload16(0, each);
#endif
}

/* v at the lanes `at` (0 .. 15). */
INLINE float16 permuted_lanes(float16 v, int16 at)
{
#if defined(HARDWARE_GATHER) && __has_builtin(__builtin_ia32_permvarsf512)
  return __builtin_astype(__builtin_ia32_permvarsf512(__builtin_astype(v, gather_float16),
                                                      __builtin_astype(at, gather_int16)),
                          float16);
#else
  return shuffle(v, as_uint16(at));
#endif
}

/* table[at] for each lane, from vector registers: fewer instructions than a gather up to some hundred entries. `at` in
 * 0 .. 31, and so on. */
#if defined(HARDWARE_GATHER) && __has_builtin(__builtin_ia32_vpermi2varps512)
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
#else
INLINE uint lane_bits(intN mask) { return (uint)mask & 1u; }
INLINE intN lanes_of(uint bits) { return -(intN)(bits & 1u); }
#endif

#endif
