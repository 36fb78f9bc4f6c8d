/* Compositing of segments of any length: tables hold e = (c D, D), colour times optical depth and optical depth, of one length, and
 * opacity is 1 - exp(-D length), `length` counted in that one:
 *   acc += (1 - A) (c, 1) (1 - exp(-D length))
 */
#ifndef COMPOSITE_PIECE_H
#define COMPOSITE_PIECE_H

#include "classify.h"
#include "half_opacity.h"
#include "opacity.h"

#if LANES == 16

#define SCALED_DEPTHS(digit_l, digit_r) \
  (float16)(e0.s##digit_l, e0.s##digit_r, e1.s##digit_l, e1.s##digit_r, e2.s##digit_l, e2.s##digit_r, e3.s##digit_l, e3.s##digit_r, \
            e4.s##digit_l, e4.s##digit_r, e5.s##digit_l, e5.s##digit_r, e6.s##digit_l, e6.s##digit_r, e7.s##digit_l, e7.s##digit_r)

#define EACH_ENTRY(SET)                                                                                       \
  SET(e0, 0, 0, 1) SET(e1, 2, 2, 3) SET(e2, 4, 4, 5) SET(e3, 6, 6, 7) SET(e4, 8, 8, 9) SET(e5, 10, a, b)       \
  SET(e6, 12, c, d) SET(e7, 14, e, f)

#define ACCUMULATE_ENTRY(c, k, ka, kb, weights) acc->c += weights * ENTRY_##c;
#define ENTRY_c0 e0
#define ENTRY_c1 e1
#define ENTRY_c2 e2
#define ENTRY_c3 e3
#define ENTRY_c4 e4
#define ENTRY_c5 e5
#define ENTRY_c6 e6
#define ENTRY_c7 e7

#endif

/* (1 - exp(-x)) / x, x >= 0. Below 1/2, where most segments are, a series that needs no division. */
INLINE floatN opacity_by_depth(floatN x)
{
  floatN p = -1.0f / 40320.0f;
  p = p * x + 1.0f / 5040.0f, p = p * x - 1.0f / 720.0f, p = p * x + 1.0f / 120.0f, p = p * x - 1.0f / 24.0f;
  p = p * x + 1.0f / 6.0f, p = p * x - 0.5f, p = p * x + 1.0f;
  const intN thick = MASK(x > 0.5f);
  if (any_lane(thick)) p = select(p, opacity_of_depth(x) / x, thick);
  return p;
}

INLINE floatN weight_of_depth(floatN depth, floatN length, floatN transmittance)
{
  return transmittance * length * opacity_by_depth(depth * length);
}

#if CLASSIFICATION == CLASSIFICATION_PREINTEGRATED

/* `at`: where in `table` the entry of both lower nodes is, in floats (table_row(), and what a slice adds). */
INLINE void composite_piece(Accumulator *acc, intN at, ClassCoordinate front, ClassCoordinate back, floatN length,
                            floatN transmittance, __global const float *table, __constant const View *view)
{
  const size_t row = 4 * (size_t)view->table.y;
  const floatN right = back.fraction, left = 1.0f - right;
#if LANES == 16
  int entry[16];
  vstore16(at, 0, entry);
  const float16 f = front.fraction;
  float16 e0, e1, e2, e3, e4, e5, e6, e7;
#define BILINEAR_ENTRY(e, k, ka, kb)                                                                                  \
  {                                                                                                                   \
    __global const float *a_ = table + entry[k], *b_ = table + entry[k + 1];                                          \
    const float16 low_ = (float16)(vload8(0, a_), vload8(0, b_));                                                     \
    const float16 high_ = (float16)(vload8(0, a_ + row), vload8(0, b_ + row));                                        \
    e = low_ + f.s##ka##ka##ka##ka##ka##ka##ka##ka##kb##kb##kb##kb##kb##kb##kb##kb * (high_ - low_);                   \
  }
  EACH_ENTRY(BILINEAR_ENTRY)
#undef BILINEAR_ENTRY
  const float16 depth = left * SCALED_DEPTHS(3, b) + right * SCALED_DEPTHS(7, f);
  const float16 weight = weight_of_depth(depth, length, transmittance);
  EACH_PAIR(ACCUMULATE_ENTRY, weight * left, weight * right)
#else
  __global const float *a = table + at;
  const float8 low = vload8(0, a), high = vload8(0, a + row);
  const float8 r = low + front.fraction * (high - low);
  const float4 e = left * r.lo + right * r.hi;
  acc->c += weight_of_depth(e.w, length, transmittance) * e;
#endif
}

#else

INLINE void composite_point(Accumulator *acc, ClassCoordinate at, floatN length, floatN transmittance,
                            __global const float *table)
{
  const floatN right = at.fraction, left = 1.0f - right;
#if LANES == 16
  int entry[16];
  vstore16(at.node * 4, 0, entry);
  float16 e0, e1, e2, e3, e4, e5, e6, e7;
#define LINEAR_ENTRY(e, k, ka, kb) e = (float16)(vload8(0, table + entry[k]), vload8(0, table + entry[k + 1]));
  EACH_ENTRY(LINEAR_ENTRY)
#undef LINEAR_ENTRY
  const float16 depth = left * SCALED_DEPTHS(3, b) + right * SCALED_DEPTHS(7, f);
  const float16 weight = weight_of_depth(depth, length, transmittance);
  EACH_PAIR(ACCUMULATE_ENTRY, weight * left, weight * right)
#else
  const float8 r = vload8(0, table + at.node * 4);
  const float4 e = left * r.lo + right * r.hi;
  acc->c += weight_of_depth(e.w, length, transmittance) * e;
#endif
}

#endif

/* Opacity after a piece from t0 to t1 (in steps) with these values at its ends, and whether it passed one half there. */
INLINE void pass_opacity(const Accumulator *acc, floatN *opacity, HalfOpacity *half_, floatN t0, floatN t1, floatN front, floatN back)
{
  const floatN before = *opacity;
  *opacity = accumulated_opacity(acc);
#if WITH_DEPTH
  const intN passes = passes_half(before, *opacity);
  if (any_lane(passes)) note_half(half_, passes, before, t0, t1 - t0, front, back);
#endif
}

#endif
