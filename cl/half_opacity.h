/* Depth: where along a ray its opacity reaches one half.
 *
 * A march notes the segment in which that is (note_half), and the place in it is found once per ray, after the march
 * (half_place): where the segment's own optical depth from its front on comes to what was left, ln (2 T), T the
 * transmittance before it. Its profile is that by which it was composited:
 *   preintegrated  the value runs linearly from front to back, and D(x) = x D(front, front + x (back - front)):
 *                  optical depths scale with the length
 *   pre, post      extinction runs linearly from the front to the middle, where it was classified, and on to the back:
 *                  both ends are classified for that (note_ends) after the march; where they are not it is constant
 * Where effects change what a segment absorbs (HALF_SCALED) D has this profile times what makes it the segment's own.
 */
#ifndef HALF_OPACITY_H
#define HALF_OPACITY_H

#include "classify.h"
#include "features.h"
#include "lanes.h"
#include "opacity.h"
#include "transfer_pieces.h"
#include "view.h"
#if TRANSFER_LAYERS
#include "opacity_factors.h"
#endif

/* What was composited is noted by itself, and the profile is scaled to it. */
#define HALF_SCALED ((EFFECTS && !SEGMENT_OPACITIES) || CLASSIFICATION == CLASSIFICATION_PRE)
#define HALF_TOLERANCE 1e-4f /* steps */

typedef struct {
  floatN from;         /* where the segment begins, in steps or edges; INFINITY: none yet */
  floatN length;       /* steps */
  floatN wanted;       /* optical depth from its front to the place */
  floatN front, back;  /* values at its ends; of midpoints, both the one in the middle */
#if MIDPOINTS
  floatN first, last;  /* optical depth per step at its ends; below 0: not known */
#endif
#if HALF_SCALED
  floatN whole;        /* its optical depth */
  floatN steady;       /* the share of that which does not follow the values */
#endif
#if TRANSFER_LAYERS
  intN low, high;      /* where the two layers' tables begin, in floats, */
  floatN share;        /* and how much the second one counts */
#endif
} HalfOpacity;

INLINE HalfOpacity no_half(void)
{
  HalfOpacity half_;
  half_.from = INFINITY;
  half_.length = half_.wanted = half_.front = half_.back = 0.0f;
#if MIDPOINTS
  half_.first = half_.last = -1.0f;
#endif
#if HALF_SCALED
  half_.whole = half_.steady = 0.0f;
#endif
#if TRANSFER_LAYERS
  half_.low = half_.high = 0, half_.share = 0.0f;
#endif
  return half_;
}

/* Lanes whose opacity went past one half. */
INLINE intN passes_half(floatN before, floatN after) { return MASK(after >= 0.5f) & MASK(before < 0.5f); }

/* In a segment that surfaces may cut: between which places (edges) opacity passes one half, and the opacity before. At
 * a surface both are its place. */
typedef struct {
  floatN from, to, before; /* from: INFINITY where it does not */
} HalfBetween;

INLINE void note_between(HalfBetween *between, floatN before, floatN after, floatN from, floatN to)
{
  const intN passes = passes_half(before, after);
  between->from = select(between->from, from, passes), between->to = select(between->to, to, passes);
  between->before = select(between->before, before, passes);
}

/* Opacity passed one half, from `before`, in the lanes' segment that begins at `from`. */
INLINE void note_half(HalfOpacity *half_, intN passes, floatN before, floatN from, floatN length, floatN front,
                      floatN back)
{
  half_->from = select(half_->from, from, passes);
  half_->length = select(half_->length, length, passes);
  half_->wanted = select(half_->wanted, 0.693147181f * lane_max(1.0f + lane_log2(1.0f - before), (floatN)0.0f), passes);
  half_->front = select(half_->front, front, passes), half_->back = select(half_->back, back, passes);
}

/* After a segment from t0 to t1 (in steps), before which the rays had the opacity `before`. */
INLINE void pass_opacity(const Gathered *acc, floatN before, HalfOpacity *half_, floatN t0, floatN t1, floatN front,
                         floatN back)
{
#if WITH_DEPTH
  const intN passes = passes_half(before, acc->a);
  if (any_lane(passes)) note_half(half_, passes, before, t0, t1 - t0, front, back);
#endif
}

#if HALF_SCALED
INLINE void note_whole(HalfOpacity *half_, intN passes, floatN whole, floatN steady)
{
  half_->whole = select(half_->whole, whole, passes), half_->steady = select(half_->steady, steady, passes);
}
#endif

#if TRANSFER_LAYERS
/* Of a joint function of three values the profile is that of the row that counts more. */
INLINE void note_layers(HalfOpacity *half_, intN passes, TablePlace p)
{
  const intN row = select((intN)0, p.next_row, MASK(p.row_share > 0.5f));
  half_->low = select(half_->low, p.low + row, passes), half_->high = select(half_->high, p.high + row, passes);
  half_->share = select(half_->share, p.share, passes);
}
#endif

#if MIDPOINTS
INLINE void note_ends(HalfOpacity *half_, floatN first, floatN last) { half_->first = first, half_->last = last; }

/* x >= 0 with a x + b x^2 = d, where extinction does not fall below 0. */
INLINE floatN share_of_linear(floatN a, floatN b, floatN d)
{
  const floatN root = a + sqrt(lane_max(a * a + 4.0f * b * d, (floatN)0.0f));
  return 2.0f * d / select((floatN)1.0f, root, MASK(root > 0.0f));
}

/* How far into the segment (0 .. 1) the place is: of optical depth `wanted`, where `middle` is that of the segment if
 * all of it were as its middle is. */
INLINE floatN share_by_middle(const HalfOpacity *half_, floatN wanted, floatN middle)
{
  const intN ends = MASK(half_->first >= 0.0f) & MASK(half_->last >= 0.0f);
  const floatN a = select(middle, half_->first * half_->length, ends);
  const floatN b = select(middle, half_->last * half_->length, ends);
  const floatN half_way = 0.25f * (a + middle), beyond = wanted - half_way;
  const floatN before = lane_min(share_of_linear(a, middle - a, wanted), (floatN)0.5f);
  const floatN after = 0.5f + share_of_linear(middle, b - middle, lane_max(beyond, (floatN)0.0f));
  return select(before, after, MASK(beyond > 0.0f));
}
#endif

#if CLASSIFICATION == CLASSIFICATION_PRE

INLINE floatN share_to_half(const HalfOpacity *half_, __global const float *table, __constant const View *view)
{
  return select((floatN)0.0f, share_by_middle(half_, half_->wanted, half_->whole), MASK(half_->whole > 0.0f));
}

#else

/* Optical depth per step of values that run from `front` to `back`, of the lanes in `active`. Not inlined: it is rare,
 * and large. */
RARE floatN depth_between(floatN front, floatN back, intN active, intN first, __global const float *table,
                          __constant const View *view)
{
  const Pieces f = scene_pieces(table, first, view);
  const floatN units = units_of_step(f, view);
#if CLASSIFICATION == CLASSIFICATION_PREINTEGRATED
  return color_of_segment(front, back, units, active, f).depth;
#else
  return color_of_value(back, units, f).depth;
#endif
}

/* Optical depth of the first `part` (0 .. 1) of the segment. */
INLINE floatN optical_depth_of_part(const HalfOpacity *half_, floatN part, intN active, __global const float *table,
                                    __constant const View *view)
{
  const floatN to = half_->front + part * (half_->back - half_->front);
#if TRANSFER_LAYERS
  const floatN low = depth_between(half_->front, to, active, half_->low, table, view);
  const floatN high = depth_between(half_->front, to, active, half_->high, table, view);
  return (low + half_->share * (high - low)) * half_->length * part;
#else
  return depth_between(half_->front, to, active, (intN)0, table, view) * half_->length * part;
#endif
}

/* How far into the segment (0 .. 1) the place is. */
INLINE floatN share_to_half(const HalfOpacity *half_, __global const float *table, __constant const View *view)
{
  const floatN zero = 0.0f, one = 1.0f;
  intN noted = MASK(half_->from < INFINITY) & MASK(half_->length > 0.0f);
  const floatN whole = optical_depth_of_part(half_, one, noted, table, view);
  noted &= MASK(whole > 0.0f);
  floatN wanted = half_->wanted;
#if HALF_SCALED
  /* Of D(x) = (1 - steady) whole' D'(x) / D'(1) + steady whole' x, D' the function's and whole' what was noted: in
   * units of the first. */
  const intN absorbs = MASK(half_->whole > 0.0f);
  const floatN unit = whole / select(one, half_->whole, absorbs), uniform = half_->steady * whole;
  const floatN values = 1.0f - half_->steady;
  wanted *= unit;
#else
  const floatN uniform = 0.0f, values = 1.0f;
#endif
#if !MIDPOINTS
  wanted = lane_min(wanted, whole);
#endif
#if MIDPOINTS
  return select(zero, share_by_middle(half_, wanted, whole), noted);
#else
  /* From a parabola with the right slope at the front and the right end, which is all where extinction is linear; then
   * between the two sides, each time as far as the chord goes or half way. */
  const HalfOpacity point = *half_;
  HalfOpacity start = point;
  start.back = start.front;
  const floatN slope = values * optical_depth_of_part(&start, one, noted, table, view) + uniform;
  const floatN bend = whole - slope;
  const floatN root = slope + sqrt(lane_max(slope * slope + 4.0f * bend * wanted, zero));
  floatN x = select(zero, lane_clamp(2.0f * wanted / select(one, root, MASK(root > 0.0f)), zero, one), noted);
  const floatN tolerance = HALF_TOLERANCE / lane_max(half_->length, one);
  floatN low = zero, high = one, below = -wanted, above = whole - wanted;
  intN open = noted & MASK(x > 0.0f) & MASK(x < 1.0f);
  for (int k = 0; k < 40 && any_lane(open); ++k) {
    const floatN miss = values * optical_depth_of_part(half_, x, noted, table, view) + uniform * x - wanted;
    const intN short_ = MASK(miss < 0.0f);
    low = select(low, x, open & short_), below = select(below, miss, open & short_);
    high = select(high, x, open & ~short_), above = select(above, miss, open & ~short_);
    /* Near enough, where slopes are what they seem: beside a jump no slope says how far it is. */
    const floatN there = k ? (above - below) / lane_max(high - low, (floatN)1e-7f) : slope + 2.0f * bend * x;
    const intN near = MASK(fabs(miss) <= 0.5f * tolerance * there) & MASK(fabs(miss) <= 0.01f * wanted);
    open &= ~near & MASK(high - low > tolerance);
    const floatN chord = low - below * (high - low) / lane_max(above - below, (floatN)1e-30f);
    const floatN next = k & 1 ? 0.5f * (low + high) : lane_clamp(chord, low, high);
    x = select(x, next, open);
  }
  return x;
#endif
}

#endif

/* The place, in units of `from`, of which a step has `step`; INFINITY where opacity stays below one half. */
INLINE floatN half_place(const HalfOpacity *half_, float step, __global const float *table, __constant const View *view)
{
  const intN noted = MASK(half_->from < INFINITY);
  if (!any_lane(noted)) return half_->from;
  const floatN share = lane_clamp(share_to_half(half_, table, view), (floatN)0.0f, (floatN)1.0f);
  return select(half_->from, half_->from + share * half_->length * step, noted);
}

#endif
