/* Blocks of labels become voxels: the kinds REGIONS and RUNS of clvol/store/codecs/coded_blocks.py.
 *
 * After Piochowiak and Dachsbacher 2024 (clvol/store/codecs/labels.py): a list of labels, and which of them octants,
 * sub-blocks and samples have. A sub-block of 4^3 samples is decoded at once: planes of 64 bits are the numbers of its
 * samples, a bit of each.
 */
#ifndef DECODE_LABELS_H
#define DECODE_LABELS_H

#include "decode_codes.h"
#include "lanes.h"
#include "voxel_type.h"

#if CODED_LABELS

#define SUBBLOCK_MANY 3 /* the type of sub-blocks whose numbers count the labels of the block */

/* An index of `bits` bits (1, 2, 4 or 8) of a list that begins at p. */
INLINE int index_at(__global const uchar *p, int k, int bits)
{
  return p[k * bits >> 3] >> (k * bits & 7) & ((1 << bits) - 1);
}

/* The plane of a sub-block, a byte for each cell of 2^3 samples; `cells` moves on. */
INLINE ulong plane_of(__global const uchar *head, __global const uchar **cells)
{
  const int mixed = head[0], ones = head[1];
  ulong plane = 0;
  for (int c = 0; c < 8; ++c) {
    const int byte = mixed >> c & 1 ? *(*cells)++ : -(ones >> c & 1) & 255;
    plane |= (ulong)byte << 8 * c;
  }
  return plane;
}

/* The bits of slice z of a sub-block, 0 or 1, in C order. */
INLINE uint16 slice_bits(ulong plane, int z)
{
  const uint16 place = (uint16)(0, 1, 8, 9, 2, 3, 10, 11, 16, 17, 24, 25, 18, 19, 26, 27);
  const uint cells = (uint)(plane >> 32 * (z >> 1)) >> 4 * (z & 1);
  return (uint16)cells >> place & 1u;
}

#if VOXEL_BITS == 8
#define WHERE(bits) convert_char16(-as_int16(bits))
#elif VOXEL_BITS == 16
#define WHERE(bits) convert_short16(-as_int16(bits))
#else
#define WHERE(bits) (-as_int16(bits))
#endif

/* A slice whose numbers count any of the block's labels. */
RARE Voxel16 many_labels(__global const uchar *labels, uint16 numbers)
{
  uint number[16];
  Voxel own[16];
  vstore16(numbers, 0, number);
  for (int k = 0; k < 16; ++k) own[k] = sample_at(labels, number[k]);
  return vload16(0, own);
}

INLINE void put_regions(__global const uchar *p, const Target *target)
{
  const int s = target->extent.w, per_axis = max(s / 8, 1), octants = per_axis * per_axis * per_axis;
  const int each = s == 4 ? 1 : 8, count = p[0] + 1;
  __global const uchar *labels = p + 1, *flags = labels + count * (int)sizeof(Voxel), *types = flags;
  if (s > 4) types += (octants + 7) / 8;
  int split = s == 4;
  for (__global const uchar *q = flags; q < types; ++q) split += popcount((uint)*q);
  const int bits = count <= 2 ? 1 : count <= 4 ? 2 : count <= 16 ? 4 : 8, subs = split * each;
  /* How many indices and planes there are. */
  int indices_count = octants - split, planes_count = 0;
  for (int k = 0; k < subs; ++k) {
    const int type = types[k >> 2] >> 2 * (k & 3) & 3;
    indices_count += type == SUBBLOCK_MANY ? 0 : 1 << type;
    planes_count += type == SUBBLOCK_MANY ? bits : type;
  }
  __global const uchar *indices = types + (subs + 3) / 4, *heads = indices + (indices_count * bits + 7) / 8;
  __global const uchar *cells = heads + 2 * planes_count;

  for (int k = 0, sub = 0, index = 0; k < octants; ++k) {
    const int3 place = place_of(k, per_axis);
    const int ox = place.x * 8, oy = place.y * 8, oz = place.z * 8;
    if (s > 4 && !(flags[k >> 3] >> (k & 7) & 1)) {
      fill(sample_at(labels, index_at(indices, index++, bits)), target, ox, oy, oz, 8);
      continue;
    }
    for (int n = 0; n < each; ++n, ++sub) {
      const int x = ox + 4 * (n & 1), y = oy + 4 * (n >> 1 & 1), z = oz + 4 * (n >> 2);
      const int type = types[sub >> 2] >> 2 * (sub & 3) & 3;
      if (type == SUBBLOCK_MANY) {
        uint16 numbers[4] = {0, 0, 0, 0};
        for (int b = 0; b < bits; ++b, heads += 2) {
          const ulong plane = plane_of(heads, &cells);
          for (int c = 0; c < 4; ++c) numbers[c] |= slice_bits(plane, c) << (uint16)b;
        }
        for (int c = 0; c < 4; ++c) put_slice(many_labels(labels, numbers[c]), target, x, y, z + c);
        continue;
      }
      const Voxel16 l0 = (Voxel16)sample_at(labels, index_at(indices, index, bits));
      if (type == 0) {
        for (int c = 0; c < 4; ++c) put_slice(l0, target, x, y, z + c);
      } else {
        const Voxel16 l1 = (Voxel16)sample_at(labels, index_at(indices, index + 1, bits));
        const ulong low = plane_of(heads, &cells);
        heads += 2;
        if (type == 1) {
          for (int c = 0; c < 4; ++c) put_slice(select(l0, l1, WHERE(slice_bits(low, c))), target, x, y, z + c);
        } else {
          const Voxel16 l2 = (Voxel16)sample_at(labels, index_at(indices, index + 2, bits));
          const Voxel16 l3 = (Voxel16)sample_at(labels, index_at(indices, index + 3, bits));
          const ulong high = plane_of(heads, &cells);
          heads += 2;
          for (int c = 0; c < 4; ++c) {
            const Voxel16 even = select(l0, l1, WHERE(slice_bits(low, c)));
            const Voxel16 odd = select(l2, l3, WHERE(slice_bits(low, c)));
            put_slice(select(even, odd, WHERE(slice_bits(high, c))), target, x, y, z + c);
          }
        }
      }
      index += 1 << type;
    }
  }
}

INLINE void put_runs(__global const uchar *p, const Target *target)
{
  __global const uchar *labels = p + 1;
  p += 1 + (p[0] + 1) * (int)sizeof(Voxel);
  const int s = target->extent.w, count = (p[0] | p[1] << 8) + 1;
  __global const uchar *lengths = p + 2, *indices = lengths + 2 * count;
  int left = 0;
  Voxel label = 0;
  for (int z = 0; z < s; ++z)
    for (int y = 0; y < s; ++y)
      for (int x = 0; x < s; ++x) {
        if (left == 0) {
          left = (lengths[0] | lengths[1] << 8) + 1;
          label = sample_at(labels, *indices++);
          lengths += 2;
        }
        --left;
        if (x < target->extent.x && y < target->extent.y && z < target->extent.z)
          target->at[z * target->slice + y * target->row + x] = label;
      }
}

#endif
#endif
