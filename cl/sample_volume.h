/* The reconstruction filters: fetch_sample() for lattice points (clamped to the domain), then its value.
 *
 * To add a filter: its two functions, a value of FILTER in features.h, and a few lines in the selector below:
 * FETCH_AHEAD where what is fetched is small enough to be held for two steps.
 */
#ifndef SAMPLE_VOLUME_H
#define SAMPLE_VOLUME_H

#include "features.h"
#include "fetch_voxel.h"
#include "lanes.h"
#include "sample_linear.h"
#include "view.h"

#define KERNEL_FILTER (FILTER >= FILTER_MITCHELL)
#define WIDE_FILTER (FILTER == FILTER_CUBIC || FILTER == FILTER_CATMULL_ROM || KERNEL_FILTER)
#if KERNEL_FILTER
#include "kernel_filter.h"
#endif

/* Four voxels in a row, index - 1 ... index + 2, with weights w0 ... w3, in the two blocks of two that fetch_voxel.h
 * fetches. Beyond the volume its outermost voxels count: there (`first`, `last`) a block moves inwards and its two
 * weights fall on the one voxel. */
typedef struct {
  intN low, high;        /* where the two blocks begin */
  floatN w0, w1, w2, w3; /* of their voxels */
} SplineAxis;

INLINE SplineAxis axis_in_blocks(intN index, intN first, intN last, floatN w0, floatN w1, floatN w2, floatN w3)
{
  SplineAxis a;
  const floatN zero = 0.0f;
  a.low = index - select((intN)1, (intN)0, first), a.high = index + select((intN)1, (intN)0, last);
  a.w0 = select(w0, w0 + w1, first), a.w1 = select(w1, zero, first);
  a.w2 = select(w2, zero, last), a.w3 = select(w3, w2 + w3, last);
  return a;
}

/* A weighted mean counted from the first voxel that has weight: equal values give exactly that value, and what has
 * weight 0 does not count even if it is not finite. Where weights add up to 0, `sum` alone is what they give. */
typedef struct {
  floatN base, sum;
  intN begun;
} BasedSum;

INLINE void add_weighted(BasedSum *s, floatN weight, floatN value)
{
  const intN counts = MASK(weight != 0.0f);
  s->base = select(s->base, value, counts & ~s->begun);
  s->begun |= counts;
  s->sum += select((floatN)0.0f, weight * (value - s->base), counts);
}

INLINE BasedSum based_sum(floatN p0, floatN p1, floatN p2, floatN p3, SplineAxis a)
{
  BasedSum s = {0.0f, 0.0f, 0};
  add_weighted(&s, a.w1, p1), add_weighted(&s, a.w2, p2), add_weighted(&s, a.w0, p0), add_weighted(&s, a.w3, p3);
  return s;
}

#if !WIDE_FILTER

/* Nearest voxel centre; halves round up. The fetched cell is the one that has it as a corner. */
INLINE CellSample fetch_nearest(__global const uchar *volume, __constant const View *view, floatN x, floatN y,
                                floatN z)
{
  CellSample s;
  const intN nx = TO_INT(lane_clamp(x + 0.5f, (floatN)0.0f, (floatN)view->upper.x));
  const intN ny = TO_INT(lane_clamp(y + 0.5f, (floatN)0.0f, (floatN)view->upper.y));
  const intN nz = TO_INT(lane_clamp(z + 0.5f, (floatN)0.0f, (floatN)view->upper.z));
  const intN ix = min(nx, (intN)(view->size.x - 2)), iy = min(ny, (intN)(view->size.y - 2));
  const intN iz = min(nz, (intN)(view->size.z - 2));
  s.fx = TO_FLOAT(nx - ix), s.fy = TO_FLOAT(ny - iy), s.fz = TO_FLOAT(nz - iz);
  s.corners = fetch_corners(volume, view, ix, iy, iz);
  return s;
}

INLINE floatN nearest_value(CellSample s, __constant const View *view)
{
  const Corners c = decode_corners(s.corners, view);
  const intN fx = MASK(s.fx > 0.5f), fy = MASK(s.fy > 0.5f), fz = MASK(s.fz > 0.5f);
  const floatN v00 = select(c.v000, c.v100, fx), v10 = select(c.v010, c.v110, fx);
  const floatN v01 = select(c.v001, c.v101, fx), v11 = select(c.v011, c.v111, fx);
  return select(select(v00, v10, fy), select(v01, v11, fy), fz);
}

#elif !KERNEL_FILTER

/* Filters of 64 voxels per sample, in the eight blocks of 2^3 that fetch_voxel.h fetches. (Sigg and Hadwiger, GPU Gems
 * 2 ch. 20, read the same blocks of the B-spline by a sampler's trilinear look-ups, whose places take six divisions.
 * Without a sampler the plain weights do.)
 *
 * cubic        the voxels are the coefficients of a uniform cubic B-spline (no prefilter here:
 *              clvol/device/prefilter.py)
 * catmull-rom  Catmull and Rom 1974: the piecewise cubic through the voxels with central differences as its slopes
 *              there; overshoots, since its outer weights are negative: overshoot() of clvol/features/vocabulary.py
 *              has by how much
 */
typedef struct {
  __global const uchar *volume;
  SplineAxis x, y, z;
} FetchedSample;

#if FILTER == FILTER_CUBIC
/* A block also moves where its outer voxel has no weight (u = 0 or 1), so that what it holds (NaN, say) does not
 * matter. */
INLINE SplineAxis spline_axis(floatN x, int size)
{
  const intN index = cell_index(x, size);
  const floatN u = x - TO_FLOAT(index), v = 1.0f - u;
  const floatN w0 = v * v * v * (1.0f / 6.0f), w3 = u * u * u * (1.0f / 6.0f);
  const floatN w1 = 2.0f / 3.0f - u * u * (1.0f - 0.5f * u), w2 = 2.0f / 3.0f - v * v * (1.0f - 0.5f * v);
  return axis_in_blocks(index, MASK(index == 0) | MASK(w0 == 0.0f), MASK(index == size - 2) | MASK(w3 == 0.0f), w0,
                        w1, w2, w3);
}
#define LOOSE_WEIGHTS 0 /* the second voxel of a row always has weight */
#else
INLINE SplineAxis spline_axis(floatN x, int size)
{
  const intN index = cell_index(x, size);
  const floatN u = x - TO_FLOAT(index), v = 1.0f - u;
  const floatN w0 = -0.5f * u * v * v, w3 = -0.5f * v * u * u;
  const floatN w1 = 1.0f - u * u * (2.5f - 1.5f * u), w2 = 1.0f - v * v * (2.5f - 1.5f * v);
  return axis_in_blocks(index, MASK(index == 0), MASK(index == size - 2), w0, w1, w2, w3);
}
#define LOOSE_WEIGHTS VOXEL_HOLES
#endif

INLINE FetchedSample fetch_cubic(__global const uchar *volume, __constant const View *view, floatN x, floatN y,
                                 floatN z)
{
  FetchedSample s;
  s.volume = volume;
  s.x = spline_axis(lane_clamp(x, (floatN)0.0f, (floatN)view->upper.x), view->size.x);
  s.y = spline_axis(lane_clamp(y, (floatN)0.0f, (floatN)view->upper.y), view->size.y);
  s.z = spline_axis(lane_clamp(z, (floatN)0.0f, (floatN)view->upper.z), view->size.z);
  return s;
}

/* The weighted mean of four, counted from the second: equal values give exactly that value, and since of the B-spline
 * the others never have more than 5/6 of the weight, rounding never takes its mean beyond the largest or the smallest
 * value. Leaping relies on that. */
INLINE floatN spline_mean(floatN p0, floatN p1, floatN p2, floatN p3, SplineAxis a)
{
#if LOOSE_WEIGHTS
  const BasedSum s = based_sum(p0, p1, p2, p3, a);
  return s.base + s.sum;
#endif
  return p1 + (a.w0 * (p0 - p1) + a.w2 * (p2 - p1) + a.w3 * (p3 - p1));
}

/* Four times four rows along x: likewise their mean counts from the second row of the second slice. In a loop, because
 * compilers take minutes over the straight line. */
INLINE floatN cubic_value(FetchedSample s, __constant const View *view)
{
  BasedSum all = {0.0f, 0.0f, 0};
  _Pragma("unroll 1") for (int block = 0; block < 4; ++block) {
    const int behind = block >> 1, below = block & 1;
    const intN y = below ? s.y.high : s.y.low, z = behind ? s.z.high : s.z.low;
    const floatN wy0 = below ? s.y.w2 : s.y.w0, wy1 = below ? s.y.w3 : s.y.w1;
    const floatN wz0 = behind ? s.z.w2 : s.z.w0, wz1 = behind ? s.z.w3 : s.z.w1;
    const Corners a = decode_corners(fetch_corners(s.volume, view, s.x.low, y, z), view);
    const Corners b = decode_corners(fetch_corners(s.volume, view, s.x.high, y, z), view);
    const floatN v00 = spline_mean(a.v000, a.v100, b.v000, b.v100, s.x);
    const floatN v10 = spline_mean(a.v010, a.v110, b.v010, b.v110, s.x);
    const floatN v01 = spline_mean(a.v001, a.v101, b.v001, b.v101, s.x);
    const floatN v11 = spline_mean(a.v011, a.v111, b.v011, b.v111, s.x);
#if LOOSE_WEIGHTS
    add_weighted(&all, wz0 * wy0, v00), add_weighted(&all, wz0 * wy1, v10);
    add_weighted(&all, wz1 * wy0, v01), add_weighted(&all, wz1 * wy1, v11);
#else
    if (block == 0) all.base = v11;
    all.sum += wz0 * (wy0 * (v00 - all.base) + wy1 * (v10 - all.base)) + wz1 *
        (wy0 * (v01 - all.base) + wy1 * (v11 - all.base));
#endif
  }
  return all.base + all.sum;
}

#endif

#if !WIDE_FILTER && !MINIFICATION
typedef CellSample FetchedSample;
#endif
#if MINIFICATION
#if FILTER != FILTER_LINEAR || CLASSIFICATION == CLASSIFICATION_PRE
#error "levels are blended linearly, and classified afterwards"
#endif
#include "volume_levels.h"
#define fetch_sample fetch_levels
#define sample_value levels_value
#define FETCH_AHEAD 0
#elif FILTER == FILTER_LINEAR
#define fetch_sample fetch_linear
#define sample_value linear_value
#define FETCH_AHEAD 1
#elif FILTER == FILTER_NEAREST
#define fetch_sample fetch_nearest
#define sample_value nearest_value
#define FETCH_AHEAD 1
#elif KERNEL_FILTER
#define fetch_sample fetch_kernel
#define sample_value kernel_value
#define FETCH_AHEAD 0
#elif WIDE_FILTER
#define fetch_sample fetch_cubic
#define sample_value cubic_value
#define FETCH_AHEAD 0
#else
#error "FILTER is unknown"
#endif

#if SAMPLE_REPEATS
/* For measurements alone: a sample as expensive as one from a compressed representation, where each look-up waits for
 * the one before. Values stay the same (view->zero is 0). */
INLINE FetchedSample fetch_repeated(__global const uchar *volume, __constant const View *view, floatN x, floatN y,
                                    floatN z)
{
  FetchedSample s = fetch_sample(volume, view, x, y, z);
  _Pragma("unroll 1") for (int k = 0; k < SAMPLE_REPEATS; ++k)
    s = fetch_sample(volume, view, x + view->zero * sample_value(s, view), y, z);
  return s;
}
#undef fetch_sample
#define fetch_sample fetch_repeated
#endif

#endif
