/* Classification: from reconstructed values to the colour and opacity of a ray segment.
 *
 * Values become class coordinates first: position among the nodes of the tables, 0 .. nodes - 1. The map is linear
 * where nodes are evenly spaced, else piecewise linear (WARPED_CLASSES: a table of equal bins), so that nodes
 * crowd where the transfer function varies and every control point falls on one. A value that is not finite gets coordinate
 * `nodes`, whose table entries are zero: such a sample is transparent.
 *
 *   pre            the filter's voxels are classified, extinction and emission interpolated    (P4 sec. 4)
 *   post           the value is interpolated, then classified, at the middle of the segment    (P4 sec. 4)
 *   preintegrated  table over the values at both ends of the segment, and its length           (P4 sec. 8)
 *
 * To add one: composite_segment() and composite_tail() of this form, and a value of CLASSIFICATION in features.h.
 */
#ifndef CLASSIFY_H
#define CLASSIFY_H

#include "composite.h"
#include "features.h"
#include "sample_volume.h"

#define MAY_BE_NAN VOXEL_HOLES

typedef struct {
  intN node;       /* lower node */
  floatN fraction; /* 0 .. 1 towards the next one */
  floatN position; /* node + fraction */
} ClassCoordinate;

/* Bins of the warp: warp[b] is the class coordinate of the lower edge of bin b. */
INLINE floatN class_position(floatN value, __global const float *warp, __constant const View *view)
{
  floatN p = (value - view->classes.x) * view->classes.y;
#if WARPED_CLASSES
  p = lane_clamp(p, (floatN)0.0f, (floatN)view->classes.w);
  const intN bin = min(TO_INT(p), (intN)(int)(view->classes.w - 1.0f));
  const floatN low = AS_FLOAT(gather4(warp, bin)), high = AS_FLOAT(gather4(warp + 1, bin));
  p = low + (p - TO_FLOAT(bin)) * (high - low);
#endif
  return lane_clamp(p, (floatN)0.0f, (floatN)view->classes.z);
}

INLINE ClassCoordinate class_coordinate(floatN value, __global const float *warp, __constant const View *view)
{
  ClassCoordinate c;
#if MAY_BE_NAN
  const intN bad = MASK((AS_INT(value) & 0x7f800000) == 0x7f800000);
  value = select(value, (floatN)view->classes.x, bad);
#endif
  const floatN p = class_position(value, warp, view);
  c.node = min(TO_INT(p), (intN)((int)view->classes.z - 1));
  c.fraction = p - TO_FLOAT(c.node);
  c.position = p;
#if MAY_BE_NAN
  c.node = select(c.node, (intN)((int)view->classes.z + 1), bad);
  c.fraction = select(c.fraction, (floatN)0.0f, bad);
#endif
  return c;
}

/* Whether any of these lanes can be visible: most packets in sparse data stop here, before the table. */
INLINE int may_be_visible(floatN low, floatN high, intN active, __constant const View *view)
{
  return any_lane(active & MASK(high > view->gate.x) & MASK(low < view->gate.y));
}

#if CLASSIFICATION == CLASSIFICATION_PREINTEGRATED

/* The classes at both ends of the segment from `front` to `back`.
 *
 * P4 takes the value to run linearly between its ends: the trapezoid rule, whose mean is off by s'' h^2 / 12, twice the
 * midpoint rule's error. So both ends are shifted by minus that, s'' taken from the three last samples (where `curved`): the mean of
 * the shifted chord is right to third order, and neighbouring segments still meet but for a third difference, so that no narrow peak
 * falls between them. `length` is in steps, and that of the segment before is one: where this one is shorter, s'' is that of unevenly
 * spaced samples. Shifted ends stay within the three samples: what is transparent around stays so.
 */
INLINE void shift_ends(floatN before, floatN *front, floatN *back, floatN length, intN curved)
{
#if FILTER != FILTER_NEAREST
  const floatN low = lane_min(lane_min(before, *front), *back), high = lane_max(lane_max(before, *front), *back);
  floatN shift = ((1.0f + length) * *front - length * before - *back) * (length / (6.0f * (1.0f + length)));
#if MAY_BE_NAN
  curved &= MASK((AS_INT(shift) & 0x7f800000) != 0x7f800000);
#endif
  shift = select((floatN)0.0f, shift, curved);
  *front = select(*front, lane_clamp(*front + shift, low, high), curved);
  *back = select(*back, lane_clamp(*back + shift, low, high), curved);
#endif
}

INLINE void segment_classes(floatN before, floatN front, floatN back, floatN length, intN curved,
                            __global const float *warp, __constant const View *view, ClassCoordinate *front_class,
                            ClassCoordinate *back_class)
{
  shift_ends(before, &front, &back, length, curved);
  *front_class = class_coordinate(front, warp, view);
  *back_class = class_coordinate(back, warp, view);
}

INLINE intN table_row(ClassCoordinate front, ClassCoordinate back, __constant const View *view)
{
  return (front.node * view->table.y + back.node) * 4;
}

/* acc += (1 - A) * table(front, back), bilinear. `at`: table_row() and where the lane's slice begins. */
INLINE void composite_segment_at(Accumulator *acc, intN at, ClassCoordinate front, ClassCoordinate back, floatN transmittance,
                                 __global const float *table, __constant const View *view)
{
  const size_t row = 4 * (size_t)view->table.y;
  const floatN right = transmittance * back.fraction, left = transmittance - right;
#if LANES == 16
  int entry[16];
  vstore16(at, 0, entry);
  const float16 f = front.fraction;
#define BILINEAR_PAIR(c, k, ka, kb, weights)                                                                          \
  {                                                                                                                   \
    __global const float *a_ = table + entry[k], *b_ = table + entry[k + 1];                                          \
    const float16 low_ = (float16)(vload8(0, a_), vload8(0, b_));                                                     \
    const float16 high_ = (float16)(vload8(0, a_ + row), vload8(0, b_ + row));                                        \
    acc->c += weights * (low_ + f.s##ka##ka##ka##ka##ka##ka##ka##ka##kb##kb##kb##kb##kb##kb##kb##kb * (high_ - low_)); \
  }
  EACH_PAIR(BILINEAR_PAIR, left, right)
#undef BILINEAR_PAIR
#else
  __global const float *a = table + at;
  const float8 low = vload8(0, a), high = vload8(0, a + row);
  const float8 r = low + front.fraction * (high - low);
  acc->c += left * r.lo + right * r.hi;
#endif
}

/* The same for segments of the full length, which are those of the first slice. */
INLINE void composite_segment(Accumulator *acc, ClassCoordinate front, ClassCoordinate back, floatN transmittance,
                              __global const float *table, __constant const View *view)
{
  composite_segment_at(acc, table_row(front, back, view), front, back, transmittance, table, view);
}

/* The last, shorter segment of each ray in `active`, from the shortest slice of the table that holds it: slice 1 + k has mean
 * colours and optical depths of segments of length h / 2^k. */
INLINE void composite_tail(Accumulator *acc, ClassCoordinate front, ClassCoordinate back, floatN length_in_steps,
                           floatN transmittance, intN active, __global const float *table, __constant const View *view)
{
  int entry[LANES], on[LANES];
  float f[LANES], b[LANES], length[LANES], weight[LANES];
  float4 rgba[LANES];
  STORE_LANES(table_row(front, back, view), entry), STORE_LANES(active, on);
  STORE_LANES(front.fraction, f), STORE_LANES(back.fraction, b);
  STORE_LANES(length_in_steps, length), STORE_LANES(transmittance, weight);
  EACH_LANE_ROLLED(k)
  {
    rgba[k] = 0.0f;
    if (on[k]) {
      int slice = 1;
      float ratio = length[k];
      for (; slice + 1 < view->table.z && ratio <= 0.5f; ++slice) ratio *= 2.0f;
      __global const float *a = table + (size_t)slice * 4 * view->table.w + entry[k];
      const float8 low = vload8(0, a), high = vload8(0, a + 4 * (size_t)view->table.y);
      const float8 r = low + f[k] * (high - low);
      rgba[k] = weight[k] * part_of_segment(r.lo + b[k] * (r.hi - r.lo), ratio);
    }
  }
  accumulate_lanes(acc, rgba);
}

#elif CLASSIFICATION == CLASSIFICATION_POST

/* acc += (1 - A) * table(value), linear. `first`: where the lane's slice begins. */
INLINE void composite_sample_at(Accumulator *acc, intN first, ClassCoordinate at, floatN transmittance, __global const float *table)
{
  const floatN right = transmittance * at.fraction, left = transmittance - right;
#if LANES == 16
  int entry[16];
  vstore16(first + at.node * 4, 0, entry);
#define LINEAR_PAIR(c, k, ka, kb, weights) \
  acc->c += weights * (float16)(vload8(0, table + entry[k]), vload8(0, table + entry[k + 1]));
  EACH_PAIR(LINEAR_PAIR, left, right)
#undef LINEAR_PAIR
#else
  const float8 r = vload8(0, table + first + at.node * 4);
  acc->c += left * r.lo + right * r.hi;
#endif
}

/* The same for segments of the full length, which are those of the first slice. */
INLINE void composite_sample(Accumulator *acc, ClassCoordinate at, floatN transmittance, __global const float *table)
{
  composite_sample_at(acc, (intN)0, at, transmittance, table);
}

INLINE void composite_sample_tail(Accumulator *acc, ClassCoordinate at, floatN length_in_steps, floatN transmittance,
                                  intN active, __global const float *table, __constant const View *view)
{
  int entry[LANES], on[LANES];
  float f[LANES], length[LANES], weight[LANES];
  float4 rgba[LANES];
  STORE_LANES(at.node * 4, entry), STORE_LANES(active, on), STORE_LANES(at.fraction, f);
  STORE_LANES(length_in_steps, length), STORE_LANES(transmittance, weight);
  EACH_LANE_ROLLED(k)
  {
    rgba[k] = 0.0f;
    if (on[k]) {
      const float8 r = vload8(0, table + 4 * view->table.y + entry[k]);
      rgba[k] = weight[k] * part_of_segment(r.lo + f[k] * (r.hi - r.lo), length[k]);
    }
  }
  accumulate_lanes(acc, rgba);
}

#elif CLASSIFICATION == CLASSIFICATION_PRE

/* Emission and extinction at a point, each over one step: the table holds (c tau h, tau h) of the classified voxels, and the
 * same reconstruction filter interpolates them (NaN voxels make them NaN, hence transparent). Not a fast path: the look-ups
 * of a lane's voxels are scalar. An opaque voxel's extinction is a large finite number, so that
 * zero weight times it is zero; what it touches is opaque all the same.
 */
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

/* `first`: where in `table` a lane's table begins, in floats. */
INLINE void classified_samples_in(FetchedSample s, __constant const View *view, __global const float *warp, intN first,
                                  __global const float *table, float4 *emission_extinction)
{
  floatN value[TAPS], tap_weight[TAPS];
  filter_taps(s, view, value, tap_weight);
  EACH_LANE_ROLLED(k) emission_extinction[k] = 0.0f;
  _Pragma("unroll 1") for (int v = 0; v < TAPS; ++v) {
    const ClassCoordinate at = class_coordinate(value[v], warp, view);
    int entry[LANES];
    float f[LANES], weight[LANES];
    STORE_LANES(first + at.node * 4, entry), STORE_LANES(at.fraction, f), STORE_LANES(tap_weight[v], weight);
    EACH_LANE_ROLLED(k)
    {
      const float8 r = vload8(0, table + entry[k]);
      emission_extinction[k] += weight[k] * (r.lo + f[k] * (r.hi - r.lo));
    }
  }
#if FILTER == FILTER_CATMULL_ROM
  /* Negative weights may leave less than no light and no medium. */
  EACH_LANE_ROLLED(k) emission_extinction[k] = fmax(emission_extinction[k], 0.0f);
#endif
#if MAY_BE_NAN
  /* One voxel that is not finite, used, makes the whole sample transparent. */
  floatN sum = 0.0f;
  for (int v = 0; v < TAPS; ++v)
    sum += select((floatN)0.0f, value[v] - value[v], MASK(tap_weight[v] != 0.0f));
  float bad[LANES];
  STORE_LANES(sum, bad);
  EACH_LANE_ROLLED(k) if (bad[k] != 0.0f) emission_extinction[k] = 0.0f;
#endif
}

INLINE void classified_samples(FetchedSample s, __constant const View *view, __global const float *warp,
                               __global const float *table, float4 *emission_extinction)
{
  classified_samples_in(s, view, warp, (intN)0, table, emission_extinction);
}

/* Optical depths of a step. */
INLINE floatN classified_depth(const float4 *emission_extinction)
{
  float depth[LANES];
  EACH_LANE_ROLLED(k) depth[k] = emission_extinction[k].w;
  return LOAD_LANES(depth);
}

INLINE void composite_classified(Accumulator *acc, const float4 *emission_extinction, floatN length_in_steps,
                                 floatN transmittance, intN active)
{
  int on[LANES];
  float length[LANES], weight[LANES];
  float4 rgba[LANES];
  STORE_LANES(active, on), STORE_LANES(length_in_steps, length), STORE_LANES(transmittance, weight);
  EACH_LANE_ROLLED(k)
  {
    const float4 e = emission_extinction[k];
    rgba[k] = 0.0f;
    if (on[k] && e.w > 0.0f) {
      const float opacity = -expm1(-e.w * length[k]);
      rgba[k] = weight[k] * (float4)(e.xyz * (opacity / e.w), opacity);
    }
  }
  accumulate_lanes(acc, rgba);
}

#else
#error "CLASSIFICATION is unknown"
#endif

#endif
