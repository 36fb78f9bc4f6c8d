/* Blocks of a vector-quantising codec become voxels: clvol/store/codecs/coded_blocks.py has the layout of their bytes.
 *
 * All arithmetic is in integers until a working value becomes a voxel, so that voxels are the same bits on every device
 * and in numpy (clvol/store/codecs/decode.py). Bytes are trusted: the host has checked them (check_codes).
 *
 * A sub-block of 4^3 samples is four vectors of 16 working values, one for each of its slices.
 *
 * Switches (-D): VOXEL_BITS, VOXEL_SIGNED (voxel_type.h); CODED_SIDE, samples per axis of a sub-block (2 or 4);
 * CODED_MEANS, whether FIXED blocks have means; CODED_WHOLE, whether integer voxels have all 65536 values;
 * CODED_NARROW: whether sums of codes fit into 16 bits, without the zero bits that all end with; CODED_STAGED: blocks
 * that a work-item decodes beside each other, into a buffer of its own (0: one, to where it belongs); CODED_GROUP:
 * work-items of a group; CODED_LABELS: the codec is "labels" (decode_labels.h).
 */
#ifndef DECODE_CODES_H
#define DECODE_CODES_H

#include "lanes.h"
#include "struct_fields.h"
#include "voxel_type.h"

/* Kinds of blocks, and limits: as in coded_blocks.py. */
#define BLOCK_CONSTANT 0
#define BLOCK_RAW 1
#define BLOCK_CODED 2
#define BLOCK_FIXED 3
#define BLOCK_REGIONS 4
#define BLOCK_RUNS 5
#define MOST_STAGES 12
#define ESCAPED 15
#define RAW_SAMPLES 255

/* Of a type by which memory of another type is read or written, at any place. */
#define ANYWHERE __attribute__((aligned(1), may_alias))

/* TO_VOXEL16: from 16 bits, modulo what the type holds. RowN: N voxels of a row, stored at any place in one instruction
 * (PoCL stores an uchar8 byte by byte). */
#if VOXEL_BITS == 8
#if VOXEL_SIGNED
typedef char16 Voxel16;
#define TO_VOXEL16(v) as_char16(convert_uchar16((v) & (ushort16)255))
#else
typedef uchar16 Voxel16;
#define TO_VOXEL16(v) convert_uchar16(v)
#endif
typedef uint Row4 ANYWHERE;
typedef ulong Row8 ANYWHERE;
#elif VOXEL_BITS == 16
#if VOXEL_SIGNED
typedef short16 Voxel16;
#define TO_VOXEL16(v) as_short16(v)
#else
typedef ushort16 Voxel16;
#define TO_VOXEL16(v) (v)
#endif
typedef ulong Row4 ANYWHERE;
typedef ulong2 Row8 ANYWHERE;
#else
typedef float16 Voxel16;
typedef float4 Row4 ANYWHERE;
typedef float8 Row8 ANYWHERE;
#endif
typedef Voxel16 Row16 ANYWHERE;

typedef short16 Short16 ANYWHERE;
typedef ulong Bytes8 ANYWHERE; /* bytes, loaded from any place at once: PoCL cuts vload8 in four */

/* Where a block's bytes begin in `codes`, and its first voxel in `voxels`. extent: samples that are wanted along x, y
 * and z, and in w the samples per axis of the block. limit: no more stages of it are decoded;
 * residuals only if it is greater than the codebooks' stages. */
typedef struct {
  int4 extent;
  long from, to;
  int limit;
} CodedBlock;

/* Reported to the host (struct_fields.h). */
#define CODED_BLOCK_FIELDS \
  STRUCT(CodedBlock), FIELD(CodedBlock, extent), FIELD(CodedBlock, from), FIELD(CodedBlock, to), \
      FIELD(CodedBlock, limit)

/* What all blocks of a volume share; low, span, first and scale are as in working_values.py. */
typedef struct {
  int4 shifts[MOST_STAGES / 4]; /* SHIFT(map, j) is that of stage j */
  int stages, residual_step, low, span, first;
  int unit; /* zero bits at the end of every working value, at most 7 */
  float scale;
} CodeMap;

#define SHIFT(map, j) (((__constant const int *)(map)->shifts)[j])

#define CODE_MAP_FIELDS                                                                                            \
  STRUCT(CodeMap), FIELD(CodeMap, shifts), FIELD(CodeMap, stages),                                                 \
      FIELD(CodeMap, residual_step), FIELD(CodeMap, low), FIELD(CodeMap, span), FIELD(CodeMap, first),             \
      FIELD(CodeMap, unit), FIELD(CodeMap, scale)

/* Where blocks are decoded to. */
#if CODED_STAGED
#define TARGET __private
#else
#define TARGET __global
#endif

#define HAS_STREAMING_STORES 0
#ifdef __has_builtin
#if __has_builtin(__builtin_nontemporal_store)
#undef HAS_STREAMING_STORES
#define HAS_STREAMING_STORES 1
#endif
#endif

/* Voxels of a block: that at (x, y, z) is at + x + y row + z slice. */
typedef struct {
  TARGET Voxel *at;
  long row, slice;
  int4 extent;
} Target;

/* Working values of CODED_NARROW as they are, clipped to 0 ... 65535. */
INLINE ushort16 clipped(short16 narrow, __constant const CodeMap *map)
{
  const short unit = (short)map->unit, most = (short)(65535 >> unit);
  const ushort16 w = as_ushort16(max(narrow, (short16)(short)0)) << (ushort16)(ushort)unit;
  return w | as_ushort16(narrow > (short16)most);
}

#if VOXEL_BITS == 32
INLINE float16 voxels_of16(ushort16 w, __constant const CodeMap *map)
{
  return convert_float16(convert_int16(w) + map->first) * map->scale;
}

INLINE float16 voxels_of(int16 working, __constant const CodeMap *map)
{
  return convert_float16(clamp(working, 0, 65535) + map->first) * map->scale;
}
#else
/* Voxels less `low`. */
INLINE ushort16 above_low(ushort16 w, __constant const CodeMap *map)
{
#if CODED_WHOLE
  return w;
#else
  return convert_ushort16(convert_uint16(w) * (uint16)(uint)(ushort)(map->span + 1) >> (uint16)16);
#endif
}

INLINE Voxel16 voxels_of16(ushort16 w, __constant const CodeMap *map)
{
  return TO_VOXEL16(above_low(w, map) + (ushort16)(ushort)map->low);
}

INLINE Voxel16 voxels_of(int16 working, __constant const CodeMap *map)
{
  return voxels_of16(convert_ushort16_sat(working), map);
}
#endif

/* As voxels_of, with residuals. */
INLINE Voxel16 corrected(int16 working, int16 residuals, __constant const CodeMap *map)
{
  const int16 more = residuals * map->residual_step;
#if VOXEL_BITS == 32
  return voxels_of(clamp(working, 0, 65535) + more, map);
#else
  const int16 above = clamp(convert_int16(above_low(convert_ushort16_sat(working), map)) + more, 0, map->span);
  return TO_VOXEL16(convert_ushort16(above) + (ushort16)(ushort)map->low);
#endif
}

/* Where the k-th part of a block of per_axis^3 parts is; per_axis is a power of two. */
INLINE int3 place_of(int k, int per_axis)
{
  const int bits = 31 - clz(per_axis), mask = per_axis - 1;
  return (int3)(k & mask, k >> bits & mask, k >> 2 * bits);
}

/* A sample from bytes that are not aligned. */
INLINE Voxel sample_at(__global const uchar *bytes, int k)
{
#if VOXEL_BITS == 8
  return (Voxel)bytes[k];
#elif VOXEL_BITS == 16
  return (Voxel)as_ushort(vload2(k, bytes));
#else
  return as_float(vload4(k, bytes));
#endif
}

INLINE Voxel16 samples_at(__global const uchar *bytes, int k)
{
#if VOXEL_BITS == 8 && VOXEL_SIGNED
  return as_char16(vload16(k, bytes));
#elif VOXEL_BITS == 8
  return vload16(k, bytes);
#elif VOXEL_BITS == 16 && VOXEL_SIGNED
  return (short16)(as_short8(vload16(2 * k, bytes)), as_short8(vload16(2 * k + 1, bytes)));
#elif VOXEL_BITS == 16
  return (ushort16)(as_ushort8(vload16(2 * k, bytes)), as_ushort8(vload16(2 * k + 1, bytes)));
#else
  return (float16)(as_float4(vload16(4 * k, bytes)), as_float4(vload16(4 * k + 1, bytes)),
                   as_float4(vload16(4 * k + 2, bytes)), as_float4(vload16(4 * k + 3, bytes)));
#endif
}

/* Four rows of four voxels, of which columns and rows are kept. */
RARE void put_some(Voxel16 v, TARGET Voxel *at, long row, int columns, int rows)
{
  Voxel own[16];
  vstore16(v, 0, own);
  for (int y = 0; y < rows; ++y)
    for (int x = 0; x < columns; ++x) at[y * row + x] = own[4 * y + x];
}

/* Four rows of four voxels: the third is `third` after the first, the second and the fourth are `row` after these. */
INLINE void put_rows4(Voxel16 v, TARGET Voxel *at, long row, long third)
{
#if VOXEL_BITS == 32
  const float4 r0 = v.lo.lo, r1 = v.lo.hi, r2 = v.hi.lo, r3 = v.hi.hi;
#elif VOXEL_BITS == 16
  const ulong4 rows = as_ulong4(v);
  const ulong r0 = rows.x, r1 = rows.y, r2 = rows.z, r3 = rows.w;
#else
  const uint4 rows = as_uint4(v);
  const uint r0 = rows.x, r1 = rows.y, r2 = rows.z, r3 = rows.w;
#endif
  *(TARGET Row4 *)at = r0;
  *(TARGET Row4 *)(at + row) = r1;
  *(TARGET Row4 *)(at + third) = r2;
  *(TARGET Row4 *)(at + third + row) = r3;
}

/* Likewise of eight voxels, the first four of each from a. */
INLINE void put_rows8(Voxel16 a, Voxel16 b, TARGET Voxel *at, long row, long third)
{
#if VOXEL_BITS == 32
  const float8 r0 = (float8)(a.lo.lo, b.lo.lo), r1 = (float8)(a.lo.hi, b.lo.hi);
  const float8 r2 = (float8)(a.hi.lo, b.hi.lo), r3 = (float8)(a.hi.hi, b.hi.hi);
#elif VOXEL_BITS == 16
  const ulong4 p = as_ulong4(a), q = as_ulong4(b);
  const ulong2 r0 = (ulong2)(p.x, q.x), r1 = (ulong2)(p.y, q.y), r2 = (ulong2)(p.z, q.z), r3 = (ulong2)(p.w, q.w);
#else
  const uint4 p = as_uint4(a), q = as_uint4(b);
  const ulong2 lower = as_ulong2((uint4)(p.x, q.x, p.y, q.y)), upper = as_ulong2((uint4)(p.z, q.z, p.w, q.w));
  const ulong r0 = lower.x, r1 = lower.y, r2 = upper.x, r3 = upper.y;
#endif
  *(TARGET Row8 *)at = r0;
  *(TARGET Row8 *)(at + row) = r1;
  *(TARGET Row8 *)(at + third) = r2;
  *(TARGET Row8 *)(at + third + row) = r3;
}

/* A slice of a sub-block, at (x, y, z) of the block. */
INLINE void put_slice(Voxel16 v, const Target *target, int x, int y, int z)
{
  const int columns = min(target->extent.x - x, 4), rows = min(target->extent.y - y, 4);
  TARGET Voxel *at = target->at + z * target->slice + y * target->row + x;
  if (z >= target->extent.z) return;
  if (columns == 4 && rows == 4)
    put_rows4(v, at, target->row, 2 * target->row);
  else
    put_some(v, at, target->row, columns, rows);
}

/* A slice of two sub-blocks that are neighbours along x, within the block. */
INLINE void put_slices(Voxel16 a, Voxel16 b, const Target *target, int x, int y, int z)
{
  put_rows8(a, b, target->at + z * target->slice + y * target->row + x, target->row, 2 * target->row);
}

/* The voxels from (x, y, z) on, edge^3 of them, are all v. */
INLINE void fill(Voxel v, const Target *target, int x, int y, int z, int edge)
{
  const int columns = min(target->extent.x - x, edge), rows = min(target->extent.y - y, edge);
  const int slices = min(target->extent.z - z, edge);
  TARGET Voxel *at = target->at + z * target->slice + y * target->row + x;
  const Row16 all = (Voxel16)v;
  for (int c = 0; c < slices; ++c) {
    if (columns == 8 && rows == 8) {
      put_rows8(all, all, at + c * target->slice, target->row, 2 * target->row);
      put_rows8(all, all, at + c * target->slice + 4 * target->row, target->row, 2 * target->row);
      continue;
    }
    for (int b = 0; b < rows; ++b) {
      TARGET Voxel *out = at + c * target->slice + b * target->row;
      int a = 0;
      for (; a + 16 <= columns; a += 16) *(TARGET Row16 *)(out + a) = all;
      for (; a < columns; ++a) out[a] = v;
    }
  }
}

/* All samples of a block, edge^3. */
INLINE void put_raw(__global const uchar *bytes, const Target *target, int edge)
{
  for (int z = 0; z < target->extent.z; ++z)
    for (int y = 0; y < target->extent.y; ++y) {
      TARGET Voxel *out = target->at + z * target->slice + y * target->row;
      __global const uchar *in = bytes + (z * edge + y) * edge * (int)sizeof(Voxel);
      int x = 0;
      for (; x + 16 <= target->extent.x; x += 16) *(TARGET Row16 *)(out + x) = samples_at(in, x >> 4);
      for (; x < target->extent.x; ++x) out[x] = sample_at(in, x);
    }
}

#endif
