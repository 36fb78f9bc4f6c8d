/* The gradient of levels (volume_levels.h): of each of the two, the difference over one of its voxels to either side,
 * blended as values are. Inside the volume that is the central differences of the level's voxels, interpolated; beyond
 * its outermost ones there is nothing, so that differences at its faces are over less.
 */
#ifndef GRADIENT_LEVELS_H
#define GRADIENT_LEVELS_H

#include "gradient.h"
#include "lanes.h"
#include "sample_linear.h"
#include "view.h"
#include "volume_levels.h"

/* Of one level, along axis 0, 1 or 2, per lattice unit of the volume. */
INLINE floatN level_slope(FetchedSample s, __constant const View *view, int level, int axis)
{
  const float4 scales = view->level_scales[level];
  const int4 sizes = view->level_sizes[level];
  const float scale = axis == 0 ? scales.x : axis == 1 ? scales.y : scales.z;
  const int size = axis == 0 ? sizes.x : axis == 1 ? sizes.y : sizes.z;
  const floatN at = level_coordinate(axis == 0 ? s.x : axis == 1 ? s.y : s.z, scale, size);
  floatN ends[2], values[2];
  _Pragma("unroll 1") for (int k = 0; k < 2; ++k) {
    ends[k] = lane_clamp(at + (k ? 1.0f : -1.0f), (floatN)0.0f, (floatN)(float)(size - 1));
    const floatN place = (ends[k] + 0.5f) / scale - 0.5f;
    FetchedSample end = s;
    if (axis == 0) end.x = place;
    if (axis == 1) end.y = place;
    if (axis == 2) end.z = place;
    values[k] = level_value(end, view, level);
  }
  return (values[1] - values[0]) / (ends[1] - ends[0]) * scale;
}

RARE Gradient levels_gradient(__global const uchar *volume, __constant const View *view, floatN x, floatN y, floatN z)
{
  const FetchedSample s = {volume, x, y, z};
  const LevelBlend b = levels_at(view, x, y, z);
  const intN blends = MASK(b.coarser > 0.0f);
  const int first = least_lane(b.finer), last = -least_lane(-(b.finer - blends));
  floatN slopes[3] = {0.0f, 0.0f, 0.0f};
  _Pragma("unroll 1") for (int level = first; level <= last; ++level) {
    const intN finer = MASK(b.finer == level), coarser = MASK(b.finer == level - 1) & blends;
    _Pragma("unroll 1") for (int axis = 0; axis < 3; ++axis) {
      const floatN here = level_slope(s, view, level, axis);
      slopes[axis] = select(slopes[axis], mix_corners(slopes[axis], here, b.coarser), coarser);
      slopes[axis] = select(slopes[axis], here, finer);
    }
  }
  const Gradient g = {slopes[0], slopes[1], slopes[2]};
  return finite_gradient(g);
}

#endif
