/* Compositing of segments of many lengths, in steps: the tables for a march whose steps differ (clvol/transfer/tables.py, length_tables()).
 *
 * They hold premultiplied colours of segments of 1, 2, 4 ... 2^k steps, a slice each, which are composited as they are; and behind these
 * (c D, D) of the same lengths, the longest first, and pre-integrated also of a half and a quarter of a step: all other lengths take
 * the shortest of these that holds them (composite_piece.h). Post-classified values need but one such slice, that of a step.
 */
#ifndef COMPOSITE_LENGTHS_H
#define COMPOSITE_LENGTHS_H

#include "composite_piece.h"

/* Lanes whose segment has a slice of premultiplied colours. */
INLINE intN is_whole_power(floatN length) { return MASK((AS_INT(length) & 0x7fffff) == 0) & MASK(length >= 1.0f); }
INLINE intN power_of(floatN length) { return (AS_INT(length) >> 23) - 127; }

#if CLASSIFICATION == CLASSIFICATION_PREINTEGRATED

/* Of a segment of `length` steps: its slice of (c D, D), from the beginning of the table in floats, and its length in that slice's. */
INLINE intN slice_of(floatN *length, __constant const View *view)
{
  const int longest = (view->table.z - SHORT_SLICES) / 2 - 1;
  const intN doublings = min(max(((AS_INT(*length) - 1) >> 23) - 126, (intN)-SHORT_SLICES), (intN)longest);
  *length *= AS_FLOAT((127 - doublings) << 23);
  return (2 * longest + 1 - doublings) * (4 * view->table.w);
}

/* shift_ends() of classify.h for a segment of length b behind one of length a. */
INLINE void shift_uneven_ends(floatN before, floatN *front, floatN *back, floatN a, floatN b, intN curved)
{
  const floatN low = lane_min(lane_min(before, *front), *back), high = lane_max(lane_max(before, *front), *back);
  const floatN both = a + b;
  floatN shift = (both * *front - b * before - a * *back) * (b * lane_reciprocal(6.0f * a * both));
#if MAY_BE_NAN
  curved &= finite_lanes(shift);
#endif
  shift = select((floatN)0.0f, shift, curved);
  *front = select(*front, lane_clamp(*front + shift, low, high), curved);
  *back = select(*back, lane_clamp(*back + shift, low, high), curved);
}

/* segment_classes() of classify.h likewise. */
INLINE void uneven_classes(floatN before, floatN front, floatN back, floatN a, floatN b, intN curved,
                           __global const float *warp, __constant const View *view, ClassCoordinate *front_class,
                           ClassCoordinate *back_class)
{
  shift_uneven_ends(before, &front, &back, a, b, curved);
  *front_class = class_coordinate(front, warp, view), *back_class = class_coordinate(back, warp, view);
}

/* Segments of the lanes in `active`, `length` steps long. Each way for its own lanes: what a ray gets does not depend on others. */
INLINE void composite_chord(Accumulator *acc, ClassCoordinate front, ClassCoordinate back, floatN length, floatN transmittance,
                            intN active, __global const float *table, __constant const View *view)
{
  const intN row = table_row(front, back, view), whole = active & is_whole_power(length);
  const floatN zero = 0.0f, one = 1.0f;
  if (any_lane(whole)) {
    const intN slice = select((intN)0, power_of(length), whole) * (4 * view->table.w);
    composite_segment_at(acc, slice + row, front, back, select(zero, transmittance, whole), table, view);
  }
  const intN parts = active & ~whole;
  if (any_lane(parts)) {
    floatN share = select(one, length, parts);
    const intN slice = slice_of(&share, view);
    composite_piece(acc, slice + row, front, back, share, select(zero, transmittance, parts), table, view);
  }
}

#else

/* The same of one value. */
INLINE void composite_value(Accumulator *acc, ClassCoordinate at, floatN length, floatN transmittance, intN active,
                            __global const float *table, __constant const View *view)
{
  const intN whole = active & is_whole_power(length);
  const floatN zero = 0.0f;
  if (any_lane(whole)) {
    const intN slice = select((intN)0, power_of(length), whole) * (4 * view->table.y);
    composite_sample_at(acc, slice, at, select(zero, transmittance, whole), table);
  }
  const intN parts = active & ~whole;
  if (any_lane(parts))
    composite_point(acc, at, length, select(zero, transmittance, parts), table + (size_t)(view->table.z - 1) * 4 * view->table.y);
}

#endif

#endif
