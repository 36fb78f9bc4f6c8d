/* Decodes blocks of codes into voxels (decode_codes.h): a work-item takes a block. The voxels of a block lie together, or
 * are rows of a volume.
 */
#include "decode_codes.h"
#include "decode_labels.h"
#include "struct_fields.h"

#define REPORTED_FIELDS CODED_BLOCK_FIELDS, CODE_MAP_FIELDS
REPORT_FIELDS

/* Working values of a sub-block of 4^3 samples, a vector per slice: in units of 2^unit of the map, where CODED_NARROW. */
#if CODED_NARROW
typedef struct {
  short16 w0, w1, w2, w3;
} Working;

#define START(w, mean) w.w0 = w.w1 = w.w2 = w.w3 = (short16)(short)((((mean) << 8) + 128) >> map->unit);

/* Adds a code of stage j. */
#define ADD_CODE(w, j, code)                                                                  \
  {                                                                                           \
    __global const Short16 *e = (__global const Short16 *)entries + ((j) * 256 + (code)) * 4; \
    w.w0 += e[0], w.w1 += e[1], w.w2 += e[2], w.w3 += e[3];                                   \
  }
#define VOXELS(w) voxels_of16(clipped(w, map), map)
#define SIGNED(w) convert_int16(clipped(w, map))
#else
typedef struct {
  int16 w0, w1, w2, w3;
} Working;

#define START(w, mean) w.w0 = w.w1 = w.w2 = w.w3 = (int16)(((mean) << 8) + 128);

#define ADD_CODE(w, j, code)                                      \
  {                                                               \
    __global const char *e = entries + ((j) * 256 + (code)) * 64; \
    const int16 shift = SHIFT(map, j);                            \
    w.w0 += convert_int16(vload16(0, e)) << shift;                \
    w.w1 += convert_int16(vload16(1, e)) << shift;                \
    w.w2 += convert_int16(vload16(2, e)) << shift;                \
    w.w3 += convert_int16(vload16(3, e)) << shift;                \
  }
#define VOXELS(w) voxels_of(w, map)
#define SIGNED(w) (w)
#endif

/* Eight residuals of `bits` bits each, from as many bytes. */
INLINE int8 eight_residuals(__global const uchar *packed, int bits)
{
  const long8 order = (long8)(0, 1, 2, 3, 4, 5, 6, 7);
  const ulong word = *(__global const Bytes8 *)packed;
  return convert_int8(as_long8((ulong8)word << as_ulong8(64 - bits - order * bits)) >> (long8)(64 - bits));
}

/* Adds the residuals at p, or takes the samples there, for the sub-block at (x, y, z) of working values `w`, as its
 * `head` says; returns where those of the next one begin. */
RARE __global const uchar *put_tail(__global const uchar *p, const Working *w, int head, __constant const CodeMap *map,
                                    const Target *target, int x, int y, int z)
{
  if (head == RAW_SAMPLES) {
    for (int k = 0; k < 4; ++k) put_slice(samples_at(p, k), target, x, y, z + k);
    return p + 64 * sizeof(Voxel);
  }
  const int bits = head >> 4;
  if (!bits) return p;
  const int16 r0 = (int16)(eight_residuals(p, bits), eight_residuals(p + bits, bits));
  const int16 r1 = (int16)(eight_residuals(p + 2 * bits, bits), eight_residuals(p + 3 * bits, bits));
  const int16 r2 = (int16)(eight_residuals(p + 4 * bits, bits), eight_residuals(p + 5 * bits, bits));
  const int16 r3 = (int16)(eight_residuals(p + 6 * bits, bits), eight_residuals(p + 7 * bits, bits));
  put_slice(corrected(SIGNED(w->w0), r0, map), target, x, y, z);
  put_slice(corrected(SIGNED(w->w1), r1, map), target, x, y, z + 1);
  put_slice(corrected(SIGNED(w->w2), r2, map), target, x, y, z + 2);
  put_slice(corrected(SIGNED(w->w3), r3, map), target, x, y, z + 3);
  return p + 8 * bits;
}

/* The stages of an escaped sub-block. */
INLINE int stages_of_head(int head)
{
  return head == RAW_SAMPLES ? 0 : head & 15;
}

#if CODED_SIDE == 4
/* A block of residual codes: p is after its kind. */
INLINE void put_coded(__global const uchar *p, __global const char *entries, __constant const CodeMap *map,
                      const Target *target, int limit)
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
  __global const uchar *heads = depths + (subs + 1) / 2;
  const int escaped = with_depth[ESCAPED];
  for (int k = 0; k < escaped; ++k) ++with_depth[stages_of_head(heads[k])];
  __global const uchar *next[MOST_STAGES + 1];
  next[0] = heads + escaped;
  for (int j = 0, left = subs; j < MOST_STAGES; ++j) {
    left -= with_depth[j];
    next[j + 1] = next[j] + left;
  }
  __global const uchar *tails = next[MOST_STAGES];
  const int whole = limit > map->stages;
  const int whole_block = all(target->extent.xyz >= s);

  for (int k = 0; k < octants; ++k) {
    const int3 place = place_of(k, per_axis);
    const int ox = place.x * 8, oy = place.y * 8, oz = place.z * 8;
    if (s > 4 && !(flags[k >> 3] >> (k & 7) & 1)) {
      fill(voxels_of((int16)((*means++ << 8) + 128), map).s0, target, ox, oy, oz, 8);
      continue;
    }
    if (s > 4 && whole_block) {
      for (int n = 0; n < 8; n += 2) {
        const int x = ox, y = oy + 4 * (n >> 1 & 1), z = oz + 4 * (n >> 2);
        const int both = *depths++;
        int depth_a = both & 15, depth_b = both >> 4, head_a = 0, head_b = 0;
        if (depth_a == ESCAPED) {
          head_a = *heads++;
          depth_a = stages_of_head(head_a);
        }
        if (depth_b == ESCAPED) {
          head_b = *heads++;
          depth_b = stages_of_head(head_b);
        }
        Working a, b;
        START(a, means[0])
        START(b, means[1])
        means += 2;
        const int count_a = min(depth_a, limit), count_b = min(depth_b, limit);
        for (int j = 0; j < count_a; ++j) ADD_CODE(a, j, *next[j]++)
        for (int j = 0; j < count_b; ++j) ADD_CODE(b, j, *next[j]++)
        put_slices(VOXELS(a.w0), VOXELS(b.w0), target, x, y, z);
        put_slices(VOXELS(a.w1), VOXELS(b.w1), target, x, y, z + 1);
        put_slices(VOXELS(a.w2), VOXELS(b.w2), target, x, y, z + 2);
        put_slices(VOXELS(a.w3), VOXELS(b.w3), target, x, y, z + 3);
        if (whole && head_a) tails = put_tail(tails, &a, head_a, map, target, x, y, z);
        if (whole && head_b) tails = put_tail(tails, &b, head_b, map, target, x + 4, y, z);
      }
      continue;
    }
    for (int n = 0; n < each; ++n) {
      const int x = ox + 4 * (n & 1), y = oy + 4 * (n >> 1 & 1), z = oz + 4 * (n >> 2);
      const int mean = *means++;
      int depth = *depths >> 4 * (n & 1) & 15, head = 0;
      if (n & 1) ++depths;
      if (depth == ESCAPED) {
        head = *heads++;
        depth = stages_of_head(head);
      }
      Working w;
      START(w, mean)
      const int count = min(depth, limit);
      for (int j = 0; j < count; ++j) ADD_CODE(w, j, *next[j]++)
      put_slice(VOXELS(w.w0), target, x, y, z);
      put_slice(VOXELS(w.w1), target, x, y, z + 1);
      put_slice(VOXELS(w.w2), target, x, y, z + 2);
      put_slice(VOXELS(w.w3), target, x, y, z + 3);
      if (whole && head) tails = put_tail(tails, &w, head, map, target, x, y, z);
    }
  }
}
#endif

#if CODED_SIDE == 2
/* Two sub-blocks of 2^3 that are neighbours along x, as four rows of four voxels (z, y). */
INLINE Voxel16 two_subblocks(__global const uchar *means, __global const uchar *codes, __global const char *entries,
                             __constant const CodeMap *map, int limit)
{
#if CODED_MEANS
  int16 w = (int16)((int8)((means[0] << 8) + 128), (int8)((means[1] << 8) + 128));
#else
  int16 w = 32768;
#endif
  if (limit > 0) {
    __global const Bytes8 *each = (__global const Bytes8 *)entries;
    w += convert_int16(as_char16((ulong2)(each[codes[0]], each[codes[1]]))) << (int16)SHIFT(map, 0);
  }
  const Voxel16 v = voxels_of(w, map);
  return (Voxel16)(v.s0189, v.s23ab, v.s45cd, v.s67ef);
}
#endif

/* A block whose sub-blocks all have the same stages: p is after its kind. */
INLINE void put_fixed(__global const uchar *p, __global const char *entries, __constant const CodeMap *map,
                      const Target *target, int limit)
{
  const int s = target->extent.w, per_axis = s / CODED_SIDE, subs = per_axis * per_axis * per_axis;
  limit = min(limit, map->stages);
#if CODED_SIDE == 4
  for (int k = 0; k < subs; ++k) {
    const int3 place = place_of(k, per_axis);
    const int x = place.x * 4, y = place.y * 4, z = place.z * 4;
    Working w;
    START(w, p[k])
    for (int j = 0; j < limit; ++j) ADD_CODE(w, j, p[(1 + j) * subs + k])
    put_slice(VOXELS(w.w0), target, x, y, z);
    put_slice(VOXELS(w.w1), target, x, y, z + 1);
    put_slice(VOXELS(w.w2), target, x, y, z + 2);
    put_slice(VOXELS(w.w3), target, x, y, z + 3);
  }
#else
  __global const uchar *codes = p + CODED_MEANS * subs;
  const int whole = all(target->extent.xyz >= s);
  for (int k = 0; k < subs; k += 2) {
    const int3 place = place_of(k, per_axis);
    const int x = place.x * 2, y = place.y * 2, z = place.z * 2;
    TARGET Voxel *at = target->at + z * target->slice + y * target->row + x;
    const Voxel16 v = two_subblocks(p + k, codes + k, entries, map, limit);
    if (whole && s > 4) {
      k += 2;
      put_rows8(v, two_subblocks(p + k, codes + k, entries, map, limit), at, target->row, target->slice);
    } else if (whole) {
      put_rows4(v, at, target->row, target->slice);
    } else {
      const int columns = min(target->extent.x - x, 4), count = min(target->extent.y - y, 2);
      if (z < target->extent.z) put_some(v, at, target->row, columns, count);
      if (z + 1 < target->extent.z) put_some((Voxel16)(v.hi, v.hi), at + target->slice, target->row, columns, count);
    }
  }
#endif
}

/* The block becomes voxels at `target`; returns 0 for a block of unknown kind, which is filled with `low`. */
INLINE int decode_block(const CodedBlock *block, __global const uchar *p, __global const char *entries,
                        __constant const CodeMap *map, const Target *target)
{
  const int s = target->extent.w, kind = *p++;
  if (kind == BLOCK_CONSTANT)
    fill(sample_at(p, 0), target, 0, 0, 0, s);
  else if (kind == BLOCK_RAW)
    put_raw(p, target, s);
#if CODED_LABELS
  else if (kind == BLOCK_REGIONS)
    put_regions(p, target);
  else if (kind == BLOCK_RUNS)
    put_runs(p, target);
#else
#if CODED_SIDE == 4
  else if (kind == BLOCK_CODED)
    put_coded(p, entries, map, target, block->limit);
#endif
  else if (kind == BLOCK_FIXED)
    put_fixed(p, entries, map, target, block->limit);
#endif
  else {
    fill(voxels_of((int16)0, map).s0, target, 0, 0, 0, s);
    return 0;
  }
  return 1;
}

#if CODED_STAGED
/* Blocks of 16^3 samples are decoded into a buffer that stays in the first-level cache, CODED_STAGED of them beside each
 * other along x, so that its rows are cache lines. These are then written whole and past the caches: else every line is
 * read before it is written, and rows that are a power of two apart displace each other.
 */
#define EDGE 16
#define LINE (CODED_STAGED * EDGE) /* voxels */
typedef ulong8 Line ANYWHERE;
typedef ulong8 AlignedLine __attribute__((may_alias));

INLINE void put_line(const AlignedLine *from, __global Voxel *to, int aligned)
{
#if HAS_STREAMING_STORES
  if (aligned) {
    __builtin_nontemporal_store(*from, (__global AlignedLine *)to);
    return;
  }
#endif
  *(__global Line *)to = *from;
}

/* Blocks first to last - 1 of `blocks`, of which there are at most CODED_STAGED. row: 0 where the voxels of a block lie
 * together. Returns the number of a block of unknown kind, or -1. */
INLINE int put_staged(__global const CodedBlock *blocks, int first, int last, __global const uchar *codes,
                      __global const char *entries, __constant const CodeMap *map, __global Voxel *voxels,
                      long first_code, long first_voxel, long row, long slice)
{
  AlignedLine own[EDGE * EDGE];
  const CodedBlock begin = blocks[first];
  int fault = -1, beside = row && last - first == CODED_STAGED; /* whole rows of cache lines */
  for (int k = first; k < last; ++k) {
    beside = beside && blocks[k].extent.x == EDGE && blocks[k].to == begin.to + EDGE * (k - first);
    beside = beside && all(blocks[k].extent.yz == begin.extent.yz);
  }
  const int pitch = beside ? LINE : EDGE;
  for (int k = first; k < last; ++k) {
    const CodedBlock block = blocks[k];
    __global Voxel *out = voxels + (block.to - first_voxel);
    const Target target = {(Voxel *)own + (beside ? EDGE * (k - first) : 0), pitch, pitch * EDGE, (int4)EDGE};
    if (!decode_block(&block, codes + (block.from - first_code), entries, map, &target)) fault = k;
    if (!row) {
      const int aligned = ((size_t)out & 63) == 0;
      for (int i = 0; i < EDGE * EDGE * EDGE / LINE; ++i) put_line(own + i, out + i * LINE, aligned);
    } else if (!beside) {
      const Voxel *in = (const Voxel *)own;
      for (int z = 0; z < block.extent.z; ++z)
        for (int y = 0; y < block.extent.y; ++y)
          for (int x = 0; x < block.extent.x; ++x) out[z * slice + y * row + x] = in[(z * EDGE + y) * EDGE + x];
    }
  }
  if (beside) {
    __global Voxel *out = voxels + (begin.to - first_voxel);
    const int aligned = (((size_t)out | row * sizeof(Voxel) | slice * sizeof(Voxel)) & 63) == 0;
    for (int z = 0; z < begin.extent.z; ++z)
      for (int y = 0; y < begin.extent.y; ++y) put_line(own + z * EDGE + y, out + z * slice + y * row, aligned);
  }
  return fault;
}
#endif

/* blocks   CodedBlock [count]
 * codes    bytes that they refer to, and at least 64 after them
 * entries  signed char [stages, 256, CODED_SIDE^3]; where CODED_NARROW short, times 2^(shift - unit)
 * map      CodeMap
 * voxels   Voxel; row and slice: elements to the next row and slice, or 0 and 0 where the s^3 voxels of a block lie
 *          together
 * first_code, first_voxel: of the numbers in `blocks`, those with which codes and voxels begin
 * fault    int: the number of a block of unknown kind, if there is one; else it is left alone. Such a block is filled
 *          with `low`.
 */
__kernel WIDE_VECTORS __attribute__((reqd_work_group_size(CODED_GROUP, 1, 1))) void decode_codes(
  __global const CodedBlock *restrict blocks, int count, __global const uchar *restrict codes,
  __global const char *restrict entries, __constant const CodeMap *restrict map, __global Voxel *restrict voxels,
  long first_code, long first_voxel, long row, long slice, __global int *restrict fault)
{
#if CODED_STAGED
  const int first = get_global_id(0) * CODED_STAGED;
  if (first >= count) return;
  const int unknown = put_staged(blocks, first, min(first + CODED_STAGED, count), codes, entries, map, voxels,
                                 first_code, first_voxel, row, slice);
  if (unknown >= 0) *fault = unknown;
#else
  const int k = get_global_id(0);
  if (k >= count) return;
  const CodedBlock block = blocks[k];
  const int s = block.extent.w;
  const Target target = {voxels + (block.to - first_voxel), row ? row : s, row ? slice : s * s, block.extent};
  if (!decode_block(&block, codes + (block.from - first_code), entries, map, &target)) *fault = k;
#endif
}
