/* Surfaces in a cell of a field that is no polynomial: noise perturbs its values or places. Each half of the ray's
 * stretch through the cell is sampled at its ends and its middle (or, where a parabola through the three has its
 * extreme beyond an iso-value that the three are all on one side of, at that extreme: a surface that is only grazed).
 * A change of side brackets a crossing, and regula falsi (the Illinois form, with steps over the root so that the
 * bracket shrinks from both ends) finds it in the field itself. Where the field changes sides twice between two of the
 * places both crossings are missed; where these are does not depend on the step.
 */
#ifndef CELL_SAMPLED_H
#define CELL_SAMPLED_H

#include "features.h"
#include "lanes.h"
#include "rays.h"
#include "scene.h"
#include "scene_value.h"
#include "surface_levels.h"

#define CROSSING_EDGES 5e-5f

INLINE floatN value_on_ray(const Scene *scene, const Rays *ray, floatN t)
{
  return scene_value(scene, ray->x0 + t * ray->dx, ray->y0 + t * ray->dy, ray->z0 + t * ray->dz);
}

/* Where on the stretch of `ray` (edges) from `from` on, `length` long, the value takes the bracket's level. */
INLINE floatN sampled_root(const Scene *scene, const Rays *ray, floatN from, floatN length, Bracket k, intN open,
                           uintN *taken)
{
  const floatN tolerance = CROSSING_EDGES / lane_max(length, (floatN)1e-6f);
  floatN fa = k.va - k.level, fb = k.vb - k.level;
  intN kept_a = 0, kept_b = 0; /* which end stayed last time */
  open &= MASK(k.b - k.a > tolerance);
  floatN place = 0.5f * (k.a + k.b);
  _Pragma("unroll 1") for (int i = 0; i < 48 && any_lane(open); ++i) {
    const floatN span = fb - fa;
    const intN flat = MASK(fabs(span) < 1e-37f);
    floatN x = k.a - fa * ((k.b - k.a) / select(span, (floatN)1.0f, flat));
    x = select(x, 0.5f * (k.a + k.b), flat | ~finite_lanes(x));
    x = lane_clamp(x, k.a + 0.45f * tolerance, k.b - 0.45f * tolerance);
    const floatN f = value_on_ray(scene, ray, from + x * length) - k.level;
    *taken -= AS_UINT(open);
    const intN like_a = ~(MASK(f >= 0.0f) ^ MASK(fa >= 0.0f));
    const intN to_a = open & like_a, to_b = open & ~like_a;
    fb = select(fb, 0.5f * fb, to_a & kept_b), fa = select(fa, 0.5f * fa, to_b & kept_a);
    k.a = select(k.a, x, to_a), fa = select(fa, f, to_a);
    k.b = select(k.b, x, to_b), fb = select(fb, f, to_b);
    kept_b = select(kept_b, to_a, open), kept_a = select(kept_a, to_b, open);
    open &= MASK(k.b - k.a > tolerance) & finite_lanes(f);
    place = select(place, 0.5f * (k.a + k.b), to_a | to_b);
  }
#if FILTER == FILTER_NEAREST
  return k.b; /* a jump: in the voxel beyond it, whose gradient the surface has */
#else
  return place;
#endif
}

/* The extreme of the parabola through the values at a stretch's start, middle and end: its place (0 .. 1) and value.
 * Lanes without one inside get the middle. */
INLINE floatN parabola_extreme(floatN v0, floatN vm, floatN v1, floatN *value)
{
  const floatN slope = v1 - v0, bend = 2.0f * (v0 - 2.0f * vm + v1); /* at the middle; twice the curvature */
  const intN curved = MASK(fabs(bend) > 1e-30f);
  const floatN offset = -slope / select((floatN)1.0f, 2.0f * bend, curved);
  const intN inside = curved & MASK(fabs(offset) < 0.5f);
  *value = select(vm, vm + 0.5f * slope * offset, inside);
  return select((floatN)0.5f, 0.5f + offset, inside);
}

/* The first surface in the cell that `ray` crosses from t0 to t1 (edges), where it has the values v0 and v1, from
 * `rank` of piece number `piece` on. */
INLINE CellHit look_in_cell(const Scene *scene, const Rays *ray, floatN t0, floatN t1, floatN v0, floatN v1,
                            intN piece, intN rank,
                            intN open, uintN *taken)
{
  CellHit hit = no_hit();
  Bracket bracket = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
  const floatN length = t1 - t0;
  floatN first = v0;
  _Pragma("unroll 1") for (int half_of = 0; half_of < 2; ++half_of) {
    const float start = 0.5f * (float)half_of;
    floatN middle = 0.0f, last = v1, cut = start + 0.25f, v_cut = 0.0f, peak;
    /* The value half way through the cell is known from the first half on. */
    _Pragma("unroll 1") for (int k = half_of; k < 2; ++k) {
      const floatN value = value_on_ray(scene, ray, t0 + (k == half_of ? start + 0.25f : 0.5f) * length);
      if (k == half_of) middle = value; else last = value;
      *taken -= AS_UINT(open);
    }
    const intN finite0 = open & finite_lanes(first) & finite_lanes(middle);
    const intN finite1 = open & finite_lanes(middle) & finite_lanes(last);
    v_cut = middle;
    const floatN at_peak = start + 0.5f * parabola_extreme(first, middle, last, &peak);
    const floatN low = lane_min(lane_min(first, last), middle), high = lane_max(lane_max(first, last), middle);
    const intN grazed = finite0 & finite1 &
        (meets_a_surface(scene, lane_min(low, peak), low) | meets_a_surface(scene, high, lane_max(high, peak)));
    if (any_lane(grazed)) {
      const floatN value = value_on_ray(scene, ray, t0 + at_peak * length);
      *taken -= AS_UINT(grazed);
      const intN better = grazed & finite_lanes(value);
      cut = select(cut, at_peak, better), v_cut = select(v_cut, value, better);
    }
    _Pragma("unroll 1") for (int k = 0; k < 2; ++k) {
      const intN number = 2 * half_of + k, from = select((intN)0, rank, MASK(number == piece));
      const floatN a = k ? cut : (floatN)start, b = k ? (floatN)(start + 0.5f) : cut;
      find_between(scene, number, a, b, k ? v_cut : first, k ? last : v_cut, from,
                   (k ? finite1 : finite0) & MASK(number >= piece), &hit, &bracket);
    }
    first = last;
  }
  if (any_lane(hit.found)) hit.share = sampled_root(scene, ray, t0, length, bracket, hit.found, taken);
  return hit;
}

#endif
