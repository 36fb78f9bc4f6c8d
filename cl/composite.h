/* Front-to-back compositing of a packet's rays, an array per channel.
 *
 * Opacity is accumulated, not transmittance: A += (1 - A) a keeps the small opacities of thousands of nearly
 * transparent segments, where a product of numbers just below 1 loses them.
 */
#ifndef COMPOSITE_H
#define COMPOSITE_H

#include "lanes.h"
#include "transfer_pieces.h"

typedef struct {
  floatN r, g, b, a; /* premultiplied */
} Gathered;

INLINE void gathered_clear(Gathered *acc) { acc->r = acc->g = acc->b = acc->a = 0.0f; }

/* The packet's colours, four floats per ray. */
INLINE void gathered_store(const Gathered *acc, float *rgba)
{
  float r[LANES], g[LANES], b[LANES], a[LANES];
  STORE_LANES(acc->r, r), STORE_LANES(acc->g, g), STORE_LANES(acc->b, b), STORE_LANES(acc->a, a);
  EACH_LANE(k) vstore4((float4)(r[k], g[k], b[k], a[k]), k, rgba);
}

INLINE void gathered_load(Gathered *acc, const float *rgba)
{
  float r[LANES], g[LANES], b[LANES], a[LANES];
  EACH_LANE(k) r[k] = rgba[4 * k], g[k] = rgba[4 * k + 1], b[k] = rgba[4 * k + 2], a[k] = rgba[4 * k + 3];
  acc->r = LOAD_LANES(r), acc->g = LOAD_LANES(g), acc->b = LOAD_LANES(b), acc->a = LOAD_LANES(a);
}

/* acc += (1 - A) s for the rays in `active`; others' segments may be anything. */
INLINE void composite_color(Gathered *acc, SegmentColor s, intN active)
{
  const floatN left = 1.0f - acc->a, zero = 0.0f;
  acc->r += select(zero, left * s.r, active), acc->g += select(zero, left * s.g, active);
  acc->b += select(zero, left * s.b, active), acc->a += select(zero, left * s.a, active);
}

#endif
