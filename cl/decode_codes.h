/* Blocks of a vector-quantising codec become voxels: clvol/store/codecs/coded_blocks.py has the layout of their bytes.
 *
 * All arithmetic is in integers until a working value becomes a voxel, so that voxels are the same bits on every device
 * and in numpy (clvol/store/codecs/decode.py). Bytes are trusted: the host has checked them (check_codes).
 *
 * A sub-block of 4^3 samples is four vectors of 16 working values, one for each of its slices.
 *
 * Switches (-D): VOXEL_BITS, VOXEL_SIGNED (voxel_type.h); CODED_SIDE, samples per axis of a sub-block (2 or 4);
 * CODED_MEANS, whether FIXED blocks have means.
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
#define MOST_STAGES 12
#define ESCAPED 15
#define RAW_SAMPLES 255

#if VOXEL_BITS == 8
#if VOXEL_SIGNED
typedef char4 Voxel4;
typedef char16 Voxel16;
#define TO_VOXEL16(v) convert_char16(v)
#else
typedef uchar4 Voxel4;
typedef uchar16 Voxel16;
#define TO_VOXEL16(v) convert_uchar16(v)
#endif
#elif VOXEL_BITS == 16
#if VOXEL_SIGNED
typedef short4 Voxel4;
typedef short16 Voxel16;
#define TO_VOXEL16(v) convert_short16(v)
#else
typedef ushort4 Voxel4;
typedef ushort16 Voxel16;
#define TO_VOXEL16(v) convert_ushort16(v)
#endif
#else
typedef float4 Voxel4;
typedef float16 Voxel16;
#endif

/* Where a block's bytes begin in `codes`, and its first voxel in `voxels`. extent: samples that are wanted along x, y
 * and z, and in w the samples per axis of the block. */
typedef struct {
  int4 extent;
  long from, to;
} CodedBlock;

/* Reported to the host (struct_fields.h). */
#define CODED_BLOCK_FIELDS \
  STRUCT(CodedBlock), FIELD(CodedBlock, extent), FIELD(CodedBlock, from), FIELD(CodedBlock, to)

/* What all blocks of a volume share. entries [stages, 256, CODED_SIDE^3]; limit: no more stages are decoded; low, span,
 * first, scale: as in working_values.py. */
typedef struct {
  int4 shifts[MOST_STAGES / 4]; /* SHIFT(map, j) is that of stage j */
  int stages, limit, residual_step, low, span, first;
  float scale;
} CodeMap;

#define SHIFT(map, j) (((__constant const int *)(map)->shifts)[j])

#define CODE_MAP_FIELDS                                                                                            \
  STRUCT(CodeMap), FIELD(CodeMap, shifts), FIELD(CodeMap, stages), FIELD(CodeMap, limit),                          \
      FIELD(CodeMap, residual_step), FIELD(CodeMap, low), FIELD(CodeMap, span), FIELD(CodeMap, first),             \
      FIELD(CodeMap, scale)

/* Voxels of a block: that at (x, y, z) is at + x + y row + z slice. */
typedef struct {
  __global Voxel *at;
  long row, slice;
  int4 extent;
} Target;

INLINE Voxel16 voxels_of(int16 working, __constant const CodeMap *map)
{
  const int16 w = clamp(working, 0, 65535);
#if VOXEL_BITS == 32
  return convert_float16(w + map->first) * map->scale;
#else
  return TO_VOXEL16(map->low + convert_int16(convert_uint16(w) * (uint)(map->span + 1) >> 16));
#endif
}

/* As voxels_of, with residuals. */
INLINE Voxel16 corrected(int16 working, int16 residuals, __constant const CodeMap *map)
{
  const int16 w = clamp(working, 0, 65535), more = residuals * map->residual_step;
#if VOXEL_BITS == 32
  return voxels_of(w + more, map);
#else
  const int16 voxel = map->low + convert_int16(convert_uint16(w) * (uint)(map->span + 1) >> 16);
  return TO_VOXEL16(clamp(voxel + more, map->low, map->low + map->span));
#endif
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
RARE void put_some(Voxel16 v, __global Voxel *at, long row, int columns, int rows)
{
  Voxel own[16];
  vstore16(v, 0, own);
  for (int y = 0; y < rows; ++y)
    for (int x = 0; x < columns; ++x) at[y * row + x] = own[4 * y + x];
}

/* A slice of a sub-block, at (x, y, z) of the block. */
INLINE void put_slice(Voxel16 v, const Target *target, int x, int y, int z)
{
  const int columns = min(target->extent.x - x, 4), rows = min(target->extent.y - y, 4);
  __global Voxel *at = target->at + z * target->slice + y * target->row + x;
  if (z >= target->extent.z) return;
  if (columns == 4 && rows == 4) {
    vstore4(v.lo.lo, 0, at);
    vstore4(v.lo.hi, 0, at + target->row);
    vstore4(v.hi.lo, 0, at + 2 * target->row);
    vstore4(v.hi.hi, 0, at + 3 * target->row);
  } else {
    put_some(v, at, target->row, columns, rows);
  }
}

/* The voxels from (x, y, z) on, edge^3 of them, are all v. */
INLINE void fill(Voxel v, const Target *target, int x, int y, int z, int edge)
{
  const int columns = min(target->extent.x - x, edge), rows = min(target->extent.y - y, edge);
  const int slices = min(target->extent.z - z, edge);
  __global Voxel *at = target->at + z * target->slice + y * target->row + x;
  for (int c = 0; c < slices; ++c)
    for (int b = 0; b < rows; ++b) {
      __global Voxel *out = at + c * target->slice + b * target->row;
      if (columns == 8)
        vstore8((Voxel)v, 0, out);
      else
        for (int a = 0; a < columns; ++a) out[a] = v;
    }
}

/* All samples of a block, edge^3. */
INLINE void put_raw(__global const uchar *bytes, const Target *target, int edge)
{
  for (int z = 0; z < target->extent.z; ++z)
    for (int y = 0; y < target->extent.y; ++y) {
      __global Voxel *out = target->at + z * target->slice + y * target->row;
      const int first = (z * edge + y) * edge;
      for (int x = 0; x < target->extent.x; ++x) out[x] = sample_at(bytes, first + x);
    }
}

#endif
