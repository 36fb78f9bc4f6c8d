/* What a segment emits and absorbs, one array per channel: effects change each channel by itself.
 *
 * It is (colour times optical depth, optical depth) of a segment one step long; both scale with the length. Where
 * nothing changes what a segment absorbs (SEGMENT_OPACITIES) it is (premultiplied colour, opacity) instead, which
 * saves the exponential: only the last, shorter segment of a stretch has to go back to its depth.
 */
#ifndef EMISSION_H
#define EMISSION_H

#include "classify.h"
#include "composite.h"
#include "opacity.h"
#include "transfer_pieces.h"

/* ..._in: by the functions that begin `first` floats into `table`, a lane's own. */

INLINE Emission emission_of_color(SegmentColor s)
{
#if SEGMENT_OPACITIES
  const Emission e = {s.r, s.g, s.b, s.a};
#else
  const floatN depth = lane_min(s.depth, (floatN)OPAQUE_DEPTH);
  const floatN scale = select(depth / select((floatN)1.0f, s.a, MASK(s.a > 0.0f)), (floatN)0.0f, MASK(s.a <= 0.0f));
#if LIT_AT_ENDS
  const floatN place = s.place / select((floatN)1.0f, s.a, MASK(s.a > 0.0f));
  const Emission e = {s.r * scale, s.g * scale, s.b * scale, depth, lane_clamp(place, (floatN)0.0f, (floatN)1.0f)};
#else
  const Emission e = {s.r * scale, s.g * scale, s.b * scale, depth};
#endif
#endif
  return e;
}

INLINE Emission segment_emission_in(floatN front, floatN back, intN active, intN first, __global const float *table,
                                    __constant const View *view)
{
  const Pieces f = scene_pieces(table, first, view);
  return emission_of_color(color_of_segment(front, back, units_of_step(f, view), active, f));
}

#if LIT_AT_ENDS
/* Where what is seen of segments of `length` steps lies: a shorter one hides less of itself. */
INLINE floatN place_in_segment(floatN front, floatN back, floatN length, intN active, __global const float *table,
                               __constant const View *view)
{
  const Pieces f = scene_pieces(table, (intN)0, view);
  return emission_of_color(color_of_segment(front, back, length * units_of_step(f, view), active, f)).place;
}
#endif

INLINE Emission value_emission_in(floatN value, intN first, __global const float *table, __constant const View *view)
{
  const Pieces f = scene_pieces(table, first, view);
#if SEGMENT_OPACITIES
  Emission e;
  color_of_steps(value, (intN)1, 1, (intN)-1, f, view, &e.r, &e.g, &e.b, &e.d);
  e.r *= e.d, e.g *= e.d, e.b *= e.d;
  return e;
#else
  return emission_of_color(color_of_value(value, units_of_step(f, view), f));
#endif
}

/* acc += (1 - A) (c, 1) (1 - exp(-D length)) for the rays in `active`; length in steps, at most 1. */
INLINE void composite_emission(Gathered *acc, Emission e, floatN length, intN active)
{
  const floatN left = select((floatN)0.0f, 1.0f - acc->a, active);
#if SEGMENT_OPACITIES
  floatN part = left;
  if (any_lane(active & MASK(length < 1.0f))) part = left * select((floatN)1.0f, share_of_opacity(e.d, length),
                                                                   MASK(length < 1.0f));
  acc->r += part * e.r, acc->g += part * e.g, acc->b += part * e.b, acc->a += part * e.d;
#else
  const intN thin = MASK(e.d < 1e-30f);
  const floatN opacity = opacity_of_depth(e.d * length);
  const floatN weight = left * select(opacity / select(e.d, (floatN)1.0f, thin), length, thin);
  acc->r += weight * e.r, acc->g += weight * e.g, acc->b += weight * e.b;
  acc->a += left * opacity;
#endif
}

/* The opacity of a segment of one step. */
INLINE floatN segment_opacity(Emission e)
{
#if SEGMENT_OPACITIES
  return e.d;
#else
  return opacity_of_depth(e.d);
#endif
}

#endif
