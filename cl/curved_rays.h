/* Rays that bend by the gradient of an index of refraction n, which is a function of the value: d/ds (n v) = grad n
 * along a ray of unit direction v, so dv/ds = (g - (g.v) v) / n with g = grad n (Born and Wolf 1999, section 3.2).
 *
 * A ray is straight for a step, and turns where steps meet: by the exact solution of that equation for a g and n that
 * stay. With b = g h / 2n, shortened to a length below 1, it is
 *
 *   v' = ((1 - b.b) v + 2 (1 + b.v) b) / (1 + b.b + 2 b.v),
 *
 * of unit length, and taken back by -b: steps and turns alternate as in a leapfrog scheme, of second order, with half a
 * turn where the ray enters. Where the index does not change, or there is no gradient, the ray stays as it is, bit for
 * bit. Rays may go in circles, so that they stay straight after `longest_path` edges.
 *
 * `factors` holds from index_table on two rows of index_points floats: values ascending, and indices.
 */
#ifndef CURVED_RAYS_H
#define CURVED_RAYS_H

#include "bent_rays.h"
#include "effects.h"
#include "opacity_factors.h"
#include "scene.h"
#include "scene_value.h"
#include "tally.h"

/* Turns the unit direction *forward (local) at a place (lattice) with this value, after which rays go `way` edges as if
 * it stayed; returns which of the lanes `rays` were turned. */
INLINE intN turn_rays(const Scene *scene, Vectors place, floatN value, float way, intN rays, Vectors *forward,
                      Tally *counted)
{
  __constant const Effects *e = scene->effects;
  const int n = e->index_points;
  __global const float *values = scene->factors + e->index_table;
  const TablePlace p = place_in_table(values, n, value);
  const floatN low = AS_FLOAT(gather4(values + n, p.low)), high = AS_FLOAT(gather4(values + n, p.high));
  const floatN span = AS_FLOAT(gather4(values, p.high)) - AS_FLOAT(gather4(values, p.low));
  const intN changes = rays & MASK(span > 0.0f) & MASK(low != high);
  if (!any_lane(changes)) return (intN)0;
  const floatN slope = (high - low) / select((floatN)1.0f, span, changes), index = low + p.share * (high - low);
  count_lanes(&counted[COUNT_GRADIENTS], changes);
  const Vectors gradient = scene_gradient(scene, place.x, place.y, place.z);
  const Vectors half_turn = scaled3(gradient, 0.5f * way * slope / index);
  const Vectors b = scaled3(half_turn, lane_rsqrt(1.0f + dot3(half_turn, half_turn)));
  const floatN square = dot3(b, b), along = dot3(b, *forward);
  const Vectors sum = sum3(scaled3(*forward, 1.0f - square), scaled3(b, 2.0f + 2.0f * along));
  const Vectors turned = unit3(sum);
  const intN differs = MASK(square > 0.0f) & finite_lanes(square) & MASK(dot3(turned, turned) > 0.5f);
  const intN turns = changes & differs;
  count_lanes(&counted[COUNT_BENDS], turns);
  *forward = select3(*forward, turned, turns);
  return turns;
}

#endif
