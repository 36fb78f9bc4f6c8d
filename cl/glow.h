/* Associated colours: light that the volume emits whatever it absorbs (Engel and Ertl 2002, equation 15).
 *
 * `factors` holds, from glow_table on, rows of glow_points floats: values ascending, red, green and blue of the light that an
 * edge emits there, linear in between, and the integrals of each from the first value on. The first and the last value
 * are beyond all samples. Light of a segment is the exact mean along its chord; what the segment absorbs weakens it as if
 * both were even.
 */
#ifndef GLOW_H
#define GLOW_H

#include "effects.h"
#include "opacity_factors.h"
#include "scene.h"

INLINE floatN glow_row(__global const float *rows, int n, int row, intN at) { return AS_FLOAT(gather4(rows + row * n, at)); }

/* Light of a step whose value runs from `front` to `back`, of the lanes in `active`. */
INLINE Vectors glow_between(const Scene *scene, floatN front, floatN back, intN active)
{
  __constant const Effects *e = scene->effects;
  const int n = e->glow_points;
  __global const float *rows = scene->factors + e->glow_table;
  active &= finite_lanes(front) & finite_lanes(back);
  const floatN first = rows[0], last = rows[n - 1], zero = 0.0f;
  front = lane_clamp(select(zero, front, active), first, last), back = lane_clamp(select(zero, back, active), first, last);
  const floatN low = lane_min(front, back), high = lane_max(front, back), span = high - low;
  const TablePlace a = place_in_table(rows, n, low), b = place_in_table(rows, n, high);
  /* From `low` to the end of its piece, whole pieces, and to `high`; or in one piece. */
  const intN one = MASK(a.low == b.low) | MASK(span <= 0.0f);
  const floatN head = glow_row(rows, n, 0, a.high) - low, tail = high - glow_row(rows, n, 0, b.low);
  const floatN inverse = 1.0f / select((floatN)1.0f, span, MASK(span > 0.0f));
  floatN light[3];
  _Pragma("unroll 1") for (int k = 0; k < 3; ++k) {
    const floatN a0 = glow_row(rows, n, 1 + k, a.low), a1 = glow_row(rows, n, 1 + k, a.high);
    const floatN b0 = glow_row(rows, n, 1 + k, b.low), b1 = glow_row(rows, n, 1 + k, b.high);
    const floatN at_low = a0 + a.share * (a1 - a0), at_high = b0 + b.share * (b1 - b0);
    const floatN whole = glow_row(rows, n, 4 + k, b.low) - glow_row(rows, n, 4 + k, a.high);
    const floatN sum = 0.5f * head * (at_low + a1) + whole + 0.5f * tail * (b0 + at_high);
    light[k] = select(sum * inverse, 0.5f * (at_low + at_high), one);
  }
  const floatN steps = select(zero, (floatN)scene->view->step, active);
  const Vectors found = {steps * light[0], steps * light[1], steps * light[2]};
  return found;
}

#endif
