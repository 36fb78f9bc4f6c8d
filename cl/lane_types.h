/* A packet of rays, one ray per lane: types and macros.
 *
 * LANES is 16 where one work-item marches a packet with vector registers (CPU devices), and 1 where a work-item
 * is a ray (GPUs). Masks are all bits set or none in both cases: wrap every comparison in MASK().
 */
#ifndef LANE_TYPES_H
#define LANE_TYPES_H

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

#endif
