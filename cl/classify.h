/* Classification: from reconstructed values to the colour and opacity of a ray segment.
 *
 *   pre            the filter's voxels are classified, extinction and emission interpolated
 *   post           the value is interpolated, then classified, at the middle of the segment
 *   preintegrated  the transfer function is integrated between the values at both ends of the segment
 *                  (transfer_pieces.h)
 *
 * All take the transfer function's linear pieces as they are, for segments of any length. What is not finite is
 * transparent.
 *
 * To add one: composite_segment() of this form, and a value of CLASSIFICATION in features.h.
 */
#ifndef CLASSIFY_H
#define CLASSIFY_H

#include "composite.h"
#include "features.h"
#include "lanes.h"
#include "sample_volume.h"
#include "transfer_pieces.h"
#include "view.h"

#define MAY_BE_NAN VOXEL_HOLES
/* Whether a segment is classified by the value in its middle, not by those at its ends. */
#define MIDPOINTS (CLASSIFICATION != CLASSIFICATION_PREINTEGRATED)

/* Whether any of these lanes can be visible: most packets in sparse data stop here. */
INLINE int may_be_visible(floatN low, floatN high, intN active, __constant const View *view)
{
  return any_lane(active & MASK(high > view->gate_low) & MASK(low < view->gate_high));
}

/* The values between which the function is integrated, for the segment from `front` to `back`, `b` steps long, behind
 * one of `a` steps.
 *
 * Pre-integration takes the value to run linearly between its ends: the trapezoid rule, whose mean is off by s'' h^2 /
 * 12, twice the midpoint rule's error. So both ends are shifted by minus that, s'' taken from the three last samples
 * (where `curved`): the mean of the shifted chord is right to third order, and neighbouring segments still meet but
 * for a third difference, so that no narrow peak falls between them. Shifted ends stay within the three samples: what
 * is transparent around stays so.
 */
INLINE void shift_by(floatN before, floatN *front, floatN *back, floatN shift, intN curved)
{
  const floatN low = lane_min(lane_min(before, *front), *back), high = lane_max(lane_max(before, *front), *back);
#if MAY_BE_NAN
  curved &= finite_lanes(shift);
#endif
  *front = select(*front, lane_clamp(*front + shift, low, high), curved);
  *back = select(*back, lane_clamp(*back + shift, low, high), curved);
}

/* The same behind a segment of one step. */
INLINE void shift_ends(floatN before, floatN *front, floatN *back, floatN length, intN curved)
{
#if FILTER != FILTER_NEAREST
  const floatN shift = ((1.0f + length) * *front - length * before - *back) * (length / (6.0f * (1.0f + length)));
  shift_by(before, front, back, shift, curved);
#endif
}

INLINE void shift_uneven_ends(floatN before, floatN *front, floatN *back, floatN a, floatN b, intN curved)
{
  const floatN both = a + b;
  const floatN shift = (both * *front - b * before - a * *back) * (b * lane_reciprocal(6.0f * a * both));
  shift_by(before, front, back, shift, curved);
}

/* Segments of the rays in `active`, `length` steps long, from the value `front` to `back`. */
INLINE void composite_segment(Gathered *acc, floatN front, floatN back, floatN length, intN active,
                              __global const float *table,
                              __constant const View *view)
{
  composite_color(acc, color_of_segment(front, back, length * view->step_units, active,
                                        scene_pieces(table, (intN)0, view)), active);
}

/* Of one value. */
INLINE void composite_value(Gathered *acc, floatN value, floatN length, intN active, __global const float *table,
                            __constant const View *view)
{
  composite_color(acc, color_of_value(value, length * view->step_units, scene_pieces(table, (intN)0, view)), active);
}

/* Of one value, `steps` (1 .. 8) whole steps long; `one_step`: a constant, whether all are one step. */
INLINE void composite_steps(Gathered *acc, floatN value, intN steps, int one_step, intN active,
                            __global const float *table, __constant const View *view)
{
  floatN r, g, b, opacity;
  color_of_steps(value, steps, one_step, active, scene_pieces(table, (intN)0, view), view, &r, &g, &b, &opacity);
  const floatN share = select((floatN)0.0f, (1.0f - acc->a) * opacity, active);
  acc->r += share * r, acc->g += share * g, acc->b += share * b, acc->a += share;
}

/* Emission and absorption over one step at a point. */
typedef struct {
  floatN r, g, b, d; /* colour times optical depth, and optical depth */
#if LIT_AT_ENDS
  floatN place; /* where along the segment what is seen of it lies on average, 0 .. 1 */
#endif
} Emission;

INLINE Emission no_emission(void)
{
  Emission e;
  e.r = e.g = e.b = e.d = 0.0f;
#if LIT_AT_ENDS
  e.place = 0.5f;
#endif
  return e;
}

/* (c D, D) of a value over `units` opacity units. */
INLINE Emission emission_of_value(floatN value, floatN units, Pieces f)
{
  floatN r, g, b, extinction;
  classify_value(value, f, &r, &g, &b, &extinction);
  const floatN depth = lane_min(extinction * units, (floatN)OPAQUE_DEPTH);
  const Emission e = {r * depth, g * depth, b * depth, depth};
  return e;
}

#if CLASSIFICATION == CLASSIFICATION_PRE

/* The classified voxels of a filter, interpolated by it. An opaque voxel's extinction is a large finite number, so that
 * zero weight times it is zero; what it touches is opaque all the same. */
#if !WIDE_FILTER
#define TAPS 8

INLINE void filter_taps(FetchedSample s, __constant const View *view, floatN *value, floatN *weight)
{
  const Corners c = decode_corners(s.corners, view);
  value[0] = c.v000, value[1] = c.v100, value[2] = c.v010, value[3] = c.v110;
  value[4] = c.v001, value[5] = c.v101, value[6] = c.v011, value[7] = c.v111;
  for (int v = 0; v < 8; ++v)
    weight[v] = (v & 1 ? s.fx : 1.0f - s.fx) * (v & 2 ? s.fy : 1.0f - s.fy) * (v & 4 ? s.fz : 1.0f - s.fz);
}

#elif KERNEL_FILTER
#define TAPS (KERNEL_TAPS * KERNEL_TAPS * KERNEL_TAPS)

INLINE void filter_taps(FetchedSample s, __constant const View *view, floatN *value, floatN *weight)
{
  _Pragma("unroll 1") for (int block = 0; block < TAPS / 8; ++block) {
    const int z = block / (KERNEL_BLOCKS * KERNEL_BLOCKS), y = block / KERNEL_BLOCKS % KERNEL_BLOCKS;
    const int x = block % KERNEL_BLOCKS;
    const Corners c = decode_corners(fetch_corners(s.volume, view, s.x.at[x], s.y.at[y], s.z.at[z]), view);
    const floatN corner[8] = {c.v000, c.v100, c.v010, c.v110, c.v001, c.v101, c.v011, c.v111};
    _Pragma("unroll 1") for (int v = 0; v < 8; ++v) {
      value[8 * block + v] = corner[v];
      weight[8 * block + v] = s.x.w[2 * x + (v & 1)] * s.y.w[2 * y + (v >> 1 & 1)] * s.z.w[2 * z + (v >> 2)];
    }
  }
}

#else
#define TAPS 64

INLINE void filter_taps(FetchedSample s, __constant const View *view, floatN *value, floatN *weight)
{
  const floatN wx[4] = {s.x.w0, s.x.w1, s.x.w2, s.x.w3}, wy[4] = {s.y.w0, s.y.w1, s.y.w2, s.y.w3};
  const floatN wz[4] = {s.z.w0, s.z.w1, s.z.w2, s.z.w3};
  _Pragma("unroll 1") for (int block = 0; block < 8; ++block) {
    const int x = block & 1, y = block >> 1 & 1, z = block >> 2;
    const Corners c = decode_corners(fetch_corners(s.volume, view, x ? s.x.high : s.x.low, y ? s.y.high : s.y.low,
                                                   z ? s.z.high : s.z.low), view);
    const floatN corner[8] = {c.v000, c.v100, c.v010, c.v110, c.v001, c.v101, c.v011, c.v111};
    for (int v = 0; v < 8; ++v) {
      value[8 * block + v] = corner[v];
      weight[8 * block + v] = wx[2 * x + (v & 1)] * wy[2 * y + (v >> 1 & 1)] * wz[2 * z + (v >> 2)];
    }
  }
}

#endif

/* `first`: where in `table` a lane's function begins, in floats. */
INLINE Emission classified_emission_in(FetchedSample s, __constant const View *view, intN first,
                                       __global const float *table)
{
  floatN value[TAPS], weight[TAPS];
  filter_taps(s, view, value, weight);
  const Pieces f = scene_pieces(table, first, view);
  const floatN units = units_of_step(f, view);
  Emission e = no_emission();
  _Pragma("unroll 1") for (int v = 0; v < TAPS; ++v) {
    const Emission voxel = emission_of_value(value[v], units, f);
    e.r += weight[v] * voxel.r, e.g += weight[v] * voxel.g, e.b += weight[v] * voxel.b, e.d += weight[v] * voxel.d;
  }
#if FILTER == FILTER_CATMULL_ROM || KERNEL_FILTER
  /* Negative weights may leave less than no light and no medium. */
  const floatN zero = 0.0f;
  e.r = lane_max(e.r, zero), e.g = lane_max(e.g, zero), e.b = lane_max(e.b, zero), e.d = lane_max(e.d, zero);
#endif
#if MAY_BE_NAN
  /* One voxel that is not finite, used, makes the whole sample transparent. */
  intN bad = 0;
  for (int v = 0; v < TAPS; ++v) bad |= MASK(weight[v] != 0.0f) & ~finite_lanes(value[v]);
  e.r = select(e.r, (floatN)0.0f, bad), e.g = select(e.g, (floatN)0.0f, bad);
  e.b = select(e.b, (floatN)0.0f, bad), e.d = select(e.d, (floatN)0.0f, bad);
#endif
  return e;
}

INLINE Emission classified_emission(FetchedSample s, __constant const View *view, __global const float *table)
{
  return classified_emission_in(s, view, (intN)0, table);
}

/* A sample's `length` steps. */
INLINE void composite_classified(Gathered *acc, Emission e, floatN length, intN active)
{
  const intN thin = MASK(e.d < 1e-30f);
  const floatN opacity = opacity_of_depth(e.d * length);
  const floatN weight = select(opacity / select(e.d, (floatN)1.0f, thin), length, thin);
  const SegmentColor s = {weight * e.r, weight * e.g, weight * e.b, opacity, e.d};
  composite_color(acc, s, active);
}

#endif

#if CLASSIFICATION != CLASSIFICATION_PRE && CLASSIFICATION != CLASSIFICATION_POST && \
  CLASSIFICATION != CLASSIFICATION_PREINTEGRATED
#error "CLASSIFICATION is unknown"
#endif

#endif
