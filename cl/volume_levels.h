/* Levels of a volume, where a pixel covers several voxels (Williams 1983): each level has half the lattice points of the
 * one below along the axes that were halved, means of the voxels that it stands for, and a sample is a blend of the two
 * levels between whose voxels' edges a pixel's side lies where the sample is.
 *
 * Levels follow the volume in its buffer. Lattice point j of a level whose axis was halved s times is the middle of the
 * voxels 2^s j .. 2^s (j + 1) - 1: place X = 2^-s (x + 1/2) - 1/2, clamped to the level's outermost points.
 *
 * The footprint, a pixel's side, is an affine function of the place: constant in orthographic views, in proportion to
 * the depth in perspective ones. In edges of the levels' voxels (those of level k have edges of 2^k) it is
 * p = 2^k (1 + f), and the sample is level k and, with weight f, level k + 1: the mean edge of what is blended is p. The
 * exponent and the mantissa of p are k and f, so that all devices choose alike.
 */
#ifndef VOLUME_LEVELS_H
#define VOLUME_LEVELS_H

#include "fetch_voxel.h"
#include "lanes.h"
#include "sample_linear.h"
#include "tally.h"
#include "view.h"

typedef struct {
  __global const uchar *volume;
  floatN x, y, z;
} FetchedSample;

INLINE FetchedSample fetch_levels(__global const uchar *volume, __constant const View *view, floatN x, floatN y,
                                  floatN z)
{
  const FetchedSample s = {volume, x, y, z};
  return s;
}

/* The finer level of a place, and the weight of the next one: 0 .. 1, less than 1. */
typedef struct {
  intN finer;
  floatN coarser;
} LevelBlend;

INLINE LevelBlend levels_at(__constant const View *view, floatN x, floatN y, floatN z)
{
  const float4 f = view->footprint;
  const floatN at = x * f.x + (y * f.y + (z * f.z + f.w));
  const intN bits = AS_INT(lane_clamp(at, (floatN)view->footprints.x, (floatN)view->footprints.y));
  LevelBlend b;
  b.finer = (bits >> 23) - 127;
  b.coarser = AS_FLOAT((bits & 0x7fffff) | 0x3f800000) - 1.0f;
  return b;
}

/* A coordinate along one axis of a level. */
INLINE floatN level_coordinate(floatN x, float scale, int size)
{
  return lane_clamp(x * scale + (0.5f * scale - 0.5f), (floatN)0.0f, (floatN)(float)(size - 1));
}

INLINE floatN level_value(FetchedSample s, __constant const View *view, int level)
{
  const float4 scale = view->level_scales[level];
  const int4 size = view->level_sizes[level];
  const floatN x = level_coordinate(s.x, scale.x, size.x), y = level_coordinate(s.y, scale.y, size.y);
  const floatN z = level_coordinate(s.z, scale.z, size.z);
  const intN ix = cell_index(x, size.x), iy = cell_index(y, size.y), iz = cell_index(z, size.z);
  const int row = size.x, slice = size.x * (size.y - VOXEL_PAIRS);
  const FetchedCorners corners =
      fetch_corners_apart(s.volume + ELEMENT_BYTES * (size_t)size.w, view, iz * slice + iy * row + ix,
                          ELEMENT_BYTES * (size_t)row, ELEMENT_BYTES * (size_t)slice);
  const CellSample cell = {corners, x - TO_FLOAT(ix), y - TO_FLOAT(iy), z - TO_FLOAT(iz)};
  return linear_value(cell, view);
}

/* One turn for each level that any lane uses: two, or one, where all lanes are about as deep. */
INLINE floatN levels_value(FetchedSample s, __constant const View *view)
{
  const LevelBlend b = levels_at(view, s.x, s.y, s.z);
  const intN blends = MASK(b.coarser > 0.0f);
  const int first = least_lane(b.finer), last = -least_lane(-(b.finer - blends));
  floatN value = 0.0f;
  _Pragma("unroll 1") for (int level = first; level <= last; ++level) {
    const floatN here = level_value(s, view, level);
    value = select(value, mix_corners(value, here, b.coarser), MASK(b.finer == level - 1) & blends);
    value = select(value, here, MASK(b.finer == level));
  }
  return value;
}

/* What plain scenes count: samples that are a blend of two levels, and those that read the voxels themselves. */
#define COUNT_LEVEL_BLENDS 0
#define COUNT_FINEST_SAMPLES 1
#define LEVEL_COUNTERS 2

INLINE void count_levels(Tally *counted, __constant const View *view, floatN x, floatN y, floatN z, intN active)
{
  const LevelBlend b = levels_at(view, x, y, z);
  count_lanes(&counted[COUNT_LEVEL_BLENDS], active & MASK(b.coarser > 0.0f));
  count_lanes(&counted[COUNT_FINEST_SAMPLES], active & MASK(b.finer == 0));
}

#endif
