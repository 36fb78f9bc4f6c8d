/* Decodes blocks of codes into voxels (decode_codes.h): a work-item takes a block. The voxels of a block lie together, or
 * are rows of a volume.
 */
#include "decode_codes.h"
#include "struct_fields.h"

#define REPORTED_FIELDS CODED_BLOCK_FIELDS, CODE_MAP_FIELDS
REPORT_FIELDS

/* Adds a stage's code to the working values of a sub-block of 4^3 samples. */
#define ADD_ENTRY(entry, shift)                                \
  {                                                            \
    __global const char *e = (entry);                          \
    w0 += convert_int16(vload16(0, e)) << (int16)(shift);      \
    w1 += convert_int16(vload16(1, e)) << (int16)(shift);      \
    w2 += convert_int16(vload16(2, e)) << (int16)(shift);      \
    w3 += convert_int16(vload16(3, e)) << (int16)(shift);      \
  }

/* Eight residuals of `bits` bits each, from as many bytes. */
INLINE int8 eight_residuals(__global const uchar *packed, int bits)
{
  const long8 order = (long8)(0, 1, 2, 3, 4, 5, 6, 7);
  const ulong word = as_ulong(vload8(0, packed));
  return convert_int8(as_long8((ulong8)word << as_ulong8(64 - bits - order * bits)) >> (long8)(64 - bits));
}

/* The escape at p becomes the sub-block at (x, y, z); returns where the next one begins. */
RARE __global const uchar *put_escape(__global const uchar *p, __global const char *entries,
                                      __constant const CodeMap *map, int mean, const Target *target, int x, int y,
                                      int z)
{
  const int head = *p++;
  if (head == RAW_SAMPLES) {
    for (int k = 0; k < 4; ++k) put_slice(samples_at(p, k), target, x, y, z + k);
    return p + 64 * sizeof(Voxel);
  }
  const int stages = head & 15, bits = head >> 4;
  int16 w0 = (mean << 8) + 128, w1 = w0, w2 = w0, w3 = w0;
  for (int j = 0; j < stages; ++j) ADD_ENTRY(entries + (j * 256 + *p++) * 64, SHIFT(map, j));
  int16 r0 = 0, r1 = 0, r2 = 0, r3 = 0;
  if (bits) {
    r0 = (int16)(eight_residuals(p, bits), eight_residuals(p + bits, bits));
    r1 = (int16)(eight_residuals(p + 2 * bits, bits), eight_residuals(p + 3 * bits, bits));
    r2 = (int16)(eight_residuals(p + 4 * bits, bits), eight_residuals(p + 5 * bits, bits));
    r3 = (int16)(eight_residuals(p + 6 * bits, bits), eight_residuals(p + 7 * bits, bits));
  }
  put_slice(corrected(w0, r0, map), target, x, y, z);
  put_slice(corrected(w1, r1, map), target, x, y, z + 1);
  put_slice(corrected(w2, r2, map), target, x, y, z + 2);
  put_slice(corrected(w3, r3, map), target, x, y, z + 3);
  return p + 8 * bits;
}

#if CODED_SIDE == 4
/* A block of residual codes: p is after its kind. */
INLINE void put_coded(__global const uchar *p, __global const char *entries, __constant const CodeMap *map,
                      const Target *target)
{
  const int s = target->extent.w, per_axis = max(s / 8, 1), octants = per_axis * per_axis * per_axis;
  const int each = s == 4 ? 1 : 8;
  __global const uchar *flags = p;
  int split = 1;
  if (s > 4) {
    const int bytes = (octants + 7) / 8;
    split = 0;
    for (int k = 0; k < bytes; ++k) split += popcount((uint)p[k]);
    p += bytes;
  }
  __global const uchar *means = p, *depths = p + octants + split * (each - 1);
  const int subs = split * each;
  /* Where the next code of each stage is. */
  int with_depth[16];
  for (int k = 0; k < 16; ++k) with_depth[k] = 0;
  for (int k = 0; k < subs / 2; ++k) {
    ++with_depth[depths[k] & 15];
    ++with_depth[depths[k] >> 4];
  }
  if (s == 4) ++with_depth[depths[0]];
  __global const uchar *next[MOST_STAGES + 1];
  next[0] = depths + (subs + 1) / 2;
  for (int j = 0, left = subs - with_depth[ESCAPED]; j < MOST_STAGES; ++j) {
    left -= with_depth[j];
    next[j + 1] = next[j] + left;
  }
  __global const uchar *escapes = next[MOST_STAGES];
  const int limit = map->limit, whole = limit >= map->stages;

  for (int k = 0, sub = 0; k < octants; ++k) {
    const int ox = k % per_axis * 8, oy = k / per_axis % per_axis * 8, oz = k / (per_axis * per_axis) * 8;
    if (s > 4 && !(flags[k >> 3] >> (k & 7) & 1)) {
      fill(voxels_of((int16)((*means++ << 8) + 128), map).s0, target, ox, oy, oz, 8);
      continue;
    }
    for (int n = 0; n < each; ++n, ++sub) {
      const int x = ox + 4 * (n & 1), y = oy + 4 * (n >> 1 & 1), z = oz + 4 * (n >> 2);
      const int mean = *means++, depth = s == 4 ? depths[0] : depths[sub >> 1] >> 4 * (sub & 1) & 15;
      if (depth == ESCAPED && whole) {
        escapes = put_escape(escapes, entries, map, mean, target, x, y, z);
        continue;
      }
      int16 w0 = (mean << 8) + 128, w1 = w0, w2 = w0, w3 = w0;
      const int count = depth == ESCAPED ? 0 : min(depth, limit);
      for (int j = 0; j < count; ++j) ADD_ENTRY(entries + (j * 256 + *next[j]++) * 64, SHIFT(map, j));
      put_slice(voxels_of(w0, map), target, x, y, z);
      put_slice(voxels_of(w1, map), target, x, y, z + 1);
      put_slice(voxels_of(w2, map), target, x, y, z + 2);
      put_slice(voxels_of(w3, map), target, x, y, z + 3);
    }
  }
}
#endif

/* A block whose sub-blocks all have the same stages: p is after its kind. */
INLINE void put_fixed(__global const uchar *p, __global const char *entries, __constant const CodeMap *map,
                      const Target *target)
{
  const int s = target->extent.w, per_axis = s / CODED_SIDE, subs = per_axis * per_axis * per_axis;
  const int limit = min(map->limit, map->stages);
#if CODED_SIDE == 4
  for (int k = 0; k < subs; ++k) {
    const int x = k % per_axis * 4, y = k / per_axis % per_axis * 4, z = k / (per_axis * per_axis) * 4;
    int16 w0 = (p[k] << 8) + 128, w1 = w0, w2 = w0, w3 = w0;
    for (int j = 0; j < limit; ++j)
      ADD_ENTRY(entries + (j * 256 + p[(1 + j) * subs + k]) * 64, SHIFT(map, j));
    put_slice(voxels_of(w0, map), target, x, y, z);
    put_slice(voxels_of(w1, map), target, x, y, z + 1);
    put_slice(voxels_of(w2, map), target, x, y, z + 2);
    put_slice(voxels_of(w3, map), target, x, y, z + 3);
  }
#else
  /* Two sub-blocks that are neighbours along x: a row of four voxels from each of their rows of two. */
  __global const uchar *codes = p + CODED_MEANS * subs;
  for (int k = 0; k < subs; k += 2) {
    const int x = k % per_axis * 2, y = k / per_axis % per_axis * 2, z = k / (per_axis * per_axis) * 2;
#if CODED_MEANS
    int16 w = (int16)((int8)((p[k] << 8) + 128), (int8)((p[k + 1] << 8) + 128));
#else
    int16 w = 32768;
#endif
    if (limit > 0) {
      const char8 a = vload8(codes[k], entries), b = vload8(codes[k + 1], entries);
      w += convert_int16((char16)(a, b)) << (int16)SHIFT(map, 0);
    }
    const Voxel16 v = voxels_of(w, map);
    __global Voxel *at = target->at + z * target->slice + y * target->row + x;
    const Voxel4 r0 = (Voxel4)(v.s0, v.s1, v.s8, v.s9), r1 = (Voxel4)(v.s2, v.s3, v.sa, v.sb);
    const Voxel4 r2 = (Voxel4)(v.s4, v.s5, v.sc, v.sd), r3 = (Voxel4)(v.s6, v.s7, v.se, v.sf);
    if (all((int4)(x + 3, y + 1, z + 1, 0) < (int4)(target->extent.xyz, 1))) {
      vstore4(r0, 0, at);
      vstore4(r1, 0, at + target->row);
      vstore4(r2, 0, at + target->slice);
      vstore4(r3, 0, at + target->slice + target->row);
    } else {
      const int columns = min(target->extent.x - x, 4), rows = min(target->extent.y - y, 2);
      const Voxel16 both = (Voxel16)(r0, r1, r2, r3);
      if (z < target->extent.z) put_some(both, at, target->row, columns, rows);
      if (z + 1 < target->extent.z)
        put_some((Voxel16)(both.hi, both.hi), at + target->slice, target->row, columns, rows);
    }
  }
#endif
}

/* blocks   CodedBlock [count]
 * codes    bytes that they refer to, and at least 64 after them
 * entries  signed char [stages, 256, CODED_SIDE^3]
 * map      CodeMap
 * voxels   Voxel; row and slice: elements to the next row and slice, or 0 and 0 where the s^3 voxels of a block lie
 *          together
 * first_code, first_voxel: of the numbers in `blocks`, those with which codes and voxels begin
 * fault    int: the number of a block of unknown kind, if there is one; else it is left alone. Such a block is filled
 *          with `low`.
 */
__kernel WIDE_VECTORS __attribute__((reqd_work_group_size(1, 1, 1))) void decode_codes(
  __global const CodedBlock *restrict blocks, int count, __global const uchar *restrict codes,
  __global const char *restrict entries, __constant const CodeMap *restrict map, __global Voxel *restrict voxels,
  long first_code, long first_voxel, long row, long slice, __global int *restrict fault)
{
  const int k = get_global_id(0);
  if (k >= count) return;
  const CodedBlock block = blocks[k];
  const int s = block.extent.w;
  const Target target = {voxels + (block.to - first_voxel), row ? row : s, row ? slice : s * s, block.extent};
  __global const uchar *p = codes + (block.from - first_code);
  const int kind = *p++;
  if (kind == BLOCK_CONSTANT)
    fill(sample_at(p, 0), &target, 0, 0, 0, s);
  else if (kind == BLOCK_RAW)
    put_raw(p, &target, s);
#if CODED_SIDE == 4
  else if (kind == BLOCK_CODED)
    put_coded(p, entries, map, &target);
#endif
  else if (kind == BLOCK_FIXED)
    put_fixed(p, entries, map, &target);
  else {
    fill(voxels_of((int16)0, map).s0, &target, 0, 0, 0, s);
    *fault = k;
  }
}
