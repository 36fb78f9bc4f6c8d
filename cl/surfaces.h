/* Iso-surfaces without polygons (P4 sec. 10, P3): where the reconstructed value along a ray takes an iso-value.
 *
 * A segment is looked at in two halves, by the values at its ends and its middle (or, where a parabola through the three has its
 * extreme beyond an iso-value that the three are all on one side of, at that extreme: a surface that is only grazed). A change of
 * side brackets a crossing; regula falsi (the Illinois form, with steps over the root so that the bracket shrinks from both ends)
 * finds it in the reconstructed field itself to CROSSING_EDGES voxel edges, whatever the filter and the step.
 *
 * The volume before and behind a surface is composited in order: the segment is cut there.
 *
 * Three items a surface, iso-values ascending: (value, opacity, index of refraction, optical depth of that opacity), front colour, back
 * colour. Front is seen by a ray along which the value rises.
 */
#ifndef SURFACES_H
#define SURFACES_H

#include "emission.h"
#include "shade.h"

#define CROSSING_EDGES 5e-5f
#define MOST_BENDS 8

/* Where between a and b (shares of the segment from `from` on, `length` steps long) the value takes `level`. va, vb: the values there. */
INLINE floatN crossing_place(const Scene *scene, const Rays *ray, floatN from, floatN length, floatN a, floatN b, floatN va,
                             floatN vb, floatN level, intN crossed, uintN *taken)
{
  const floatN tolerance = CROSSING_EDGES / (lane_max(length, (floatN)1e-6f) * scene->view->march.x);
  floatN fa = va - level, fb = vb - level;
  intN kept_a = 0, kept_b = 0; /* which end stayed last time */
  intN open = crossed & MASK(b - a > tolerance);
  floatN place = 0.5f * (a + b);
  _Pragma("unroll 1") for (int k = 0; k < 48 && any_lane(open); ++k) {
    const floatN span = fb - fa;
    const intN flat = MASK(fabs(span) < 1e-37f);
    floatN x = a - fa * ((b - a) / select(span, (floatN)1.0f, flat));
    x = select(x, 0.5f * (a + b), flat | ~finite_lanes(x));
    x = lane_clamp(x, a + 0.45f * tolerance, b - 0.45f * tolerance);
    const floatN t = from + x * length;
    const floatN value = scene_value(scene, ray->x0 + t * ray->dx, ray->y0 + t * ray->dy, ray->z0 + t * ray->dz);
    *taken -= AS_UINT(open);
    const floatN f = value - level;
    const intN like_a = ~(MASK(f >= 0.0f) ^ MASK(fa >= 0.0f));
    const intN to_a = open & like_a, to_b = open & ~like_a;
    fb = select(fb, 0.5f * fb, to_a & kept_b), fa = select(fa, 0.5f * fa, to_b & kept_a);
    a = select(a, x, to_a), fa = select(fa, f, to_a);
    b = select(b, x, to_b), fb = select(fb, f, to_b);
    kept_b = select(kept_b, to_a, open), kept_a = select(kept_a, to_b, open);
    open &= MASK(b - a > tolerance) & finite_lanes(f);
    place = 0.5f * (a + b);
  }
#if FILTER == FILTER_NEAREST
  place = b; /* a jump: in the voxel beyond it, whose gradient the surface has */
#endif
  return place;
}

/* The extreme of the parabola through the values at a segment's start, middle and end: its place (0 .. 1) and value. Lanes without one
 * inside get the middle. */
INLINE floatN parabola_extreme(floatN v0, floatN vm, floatN v1, floatN *value)
{
  const floatN slope = v1 - v0, bend = 2.0f * (v0 - 2.0f * vm + v1); /* at the middle; twice the curvature */
  const intN curved = MASK(fabs(bend) > 1e-30f);
  const floatN offset = -slope / select((floatN)1.0f, 2.0f * bend, curved);
  const intN inside = curved & MASK(fabs(offset) < 0.5f);
  *value = select(vm, vm + 0.5f * slope * offset, inside);
  return select((floatN)0.5f, 0.5f + offset, inside);
}

/* Whether some iso-value lies between low and high: lanes that a surface may pass. */
INLINE intN meets_a_surface(const Scene *scene, floatN low, floatN high)
{
  intN meets = 0;
  _Pragma("unroll 1") for (int k = 0; k < scene->effects->counts.y; ++k) {
    const float level = scene->items[scene->effects->first.y + 3 * k].x;
    meets |= MASK(low < level) & MASK(high >= level);
  }
  return meets;
}

/* Lanes in whose cell, or next to it, a surface can be. (Segments may be longer than the cells around that the flags know of: then
 * the flags are set everywhere.) */
INLINE intN surfaces_near(const Scene *scene, floatN x, floatN y, floatN z)
{
#if TRANSLUCENT
  __constant const View *view = scene->view;
  const int shift = view->cells.w;
  const intN cx = min(TO_INT(lane_clamp(x, (floatN)0.0f, (floatN)view->upper.x)) >> shift, (intN)(view->cells.x - 1));
  const intN cy = min(TO_INT(lane_clamp(y, (floatN)0.0f, (floatN)view->upper.y)) >> shift, (intN)(view->cells.y - 1));
  const intN cz = min(TO_INT(lane_clamp(z, (floatN)0.0f, (floatN)view->upper.z)) >> shift, (intN)(view->cells.z - 1));
  const intN flags = AS_INT(gather1(scene->cell_flags, (cz * view->cells.y + cy) * view->cells.x + cx));
  return MASK((flags & 1) != 0);
#else
  return (intN)-1; /* where none can be nothing can be seen, and nothing is marched through */
#endif
}

#if REFRACTION
/* The rays of `ray` from step `at` on in another direction (local, unit length), to where they leave the volume. A little way from
 * the surface, so that they do not meet it again at once. */
#define BEYOND_SURFACE 2e-3f
INLINE Rays bent_rays(const Scene *scene, const Rays *ray, floatN at, Vectors direction)
{
  __constant const Effects *e = scene->effects;
  const float h = scene->view->march.x;
  Rays r = *ray;
  const floatN dx = e->gradient_x.x * direction.x + e->gradient_y.x * direction.y + e->gradient_z.x * direction.z;
  const floatN dy = e->gradient_x.y * direction.x + e->gradient_y.y * direction.y + e->gradient_z.y * direction.z;
  const floatN dz = e->gradient_x.z * direction.x + e->gradient_y.z * direction.y + e->gradient_z.z * direction.z;
  const floatN x = ray->x0 + at * ray->dx, y = ray->y0 + at * ray->dy, z = ray->z0 + at * ray->dz;
  floatN enter = BEYOND_SURFACE, leave = INFINITY;
  clip_to_slab(x, dx, scene->view->upper.x, &enter, &leave);
  clip_to_slab(y, dy, scene->view->upper.y, &enter, &leave);
  clip_to_slab(z, dz, scene->view->upper.z, &enter, &leave);
  const intN inside = MASK(leave > enter);
  enter = select((floatN)0.0f, enter, inside), leave = select((floatN)-h, leave, inside);
  r.x0 = x + enter * dx, r.y0 = y + enter * dy, r.z0 = z + enter * dz;
  r.dx = dx * h, r.dy = dy * h, r.dz = dz * h;
  r.rx = finite_inverse(r.dx, &r.px), r.ry = finite_inverse(r.dy, &r.py), r.rz = finite_inverse(r.dz, &r.pz);
  r.length = (leave - enter) / h;
  r.entry_depth = ray->entry_depth + at * h + enter;
  return r;
}
#endif

/* What happened to the rays of a packet in one segment. */
typedef struct {
  intN bends;        /* rays that go on in another direction */
  floatN at;         /* from where, in steps */
  Vectors direction; /* local, unit length */
  floatN front;      /* share of the segment that is done */
} SurfacePassage;

#if REFRACTION
/* Snell's law; total reflection where there is no refracted ray. `normal` against the ray. */
INLINE Vectors refracted(Vectors direction, Vectors normal, floatN ratio)
{
  const floatN cosine = -dot3(normal, direction), root = 1.0f - ratio * ratio * (1.0f - cosine * cosine);
  const intN total = MASK(root < 0.0f);
  const floatN through = ratio * cosine - sqrt(lane_max(root, (floatN)0.0f));
  const floatN along = select(ratio, (floatN)1.0f, total), across = select(through, 2.0f * cosine, total);
  return unit3(sum3(scaled3(direction, along), scaled3(normal, across)));
}
#endif

/* The surfaces in one segment, with the volume before, between and behind them: `e` of a whole step. */
INLINE SurfacePassage pass_surfaces(const Scene *scene, const Rays *ray, Vectors view, floatN t0, floatN length, floatN v0, floatN vm,
                                    floatN v1, Emission e, intN active, intN near, intN may_bend, Gathered *acc, HalfBetween *half_,
                                    uintN *taken, Tally *counted)
{
  __constant const Effects *effects = scene->effects;
  const int surfaces = effects->counts.y;
  SurfacePassage passage;
  passage.bends = 0, passage.at = 0.0f, passage.front = 0.0f;
  passage.direction = scaled3(view, -1.0f);
  const intN finite0 = near & finite_lanes(v0) & finite_lanes(vm), finite1 = near & finite_lanes(vm) & finite_lanes(v1);
  /* Where to cut the segment in two. */
  floatN cut = 0.5f, v_cut = vm, peak;
  const floatN at_peak = parabola_extreme(v0, vm, v1, &peak);
  const floatN low = lane_min(lane_min(v0, v1), vm), high = lane_max(lane_max(v0, v1), vm);
  const intN grazed = finite0 & finite1 & (meets_a_surface(scene, lane_min(low, peak), low) | meets_a_surface(scene, high, lane_max(high, peak)));
  if (any_lane(grazed)) {
    const floatN t = t0 + at_peak * length;
    const floatN value = scene_value(scene, ray->x0 + t * ray->dx, ray->y0 + t * ray->dy, ray->z0 + t * ray->dz);
    *taken -= AS_UINT(grazed);
    const intN better = grazed & finite_lanes(value);
    cut = select(cut, at_peak, better), v_cut = select(v_cut, value, better);
  }
  _Pragma("unroll 1") for (int side = 0; side < 2; ++side) {
    const floatN a = side ? cut : (floatN)0.0f, b = side ? (floatN)1.0f : cut;
    const floatN va = side ? v_cut : v0, vb = side ? v1 : v_cut;
    const intN finite = side ? finite1 : finite0;
    const intN rises = MASK(vb >= va);
    _Pragma("unroll 1") for (int k = 0; k < surfaces; ++k) {
      /* Ascending where the value rises, descending where it falls: in the order along the ray. */
      const intN surface = effects->first.y + 3 * select((intN)(surfaces - 1 - k), (intN)k, rises);
      const floatN level = AS_FLOAT(gather4(scene->items, 4 * surface));
      intN crosses = finite & ~passage.bends & (MASK(va >= level) ^ MASK(vb >= level));
      if (!any_lane(crosses)) continue;
      const floatN found = crossing_place(scene, ray, t0, length, a, b, va, vb, level, crosses, taken);
      const floatN place = lane_max(found, passage.front); /* rounding may not turn two surfaces round */
      const floatN t = t0 + place * length;
      const Vectors at = {ray->x0 + t * ray->dx, ray->y0 + t * ray->dy, ray->z0 + t * ray->dz};
#if FIELDS & FIELD_MASK
      crosses = mask_keeps(scene, at.x, at.y, at.z, crosses, counted);
      if (!any_lane(crosses)) continue;
#endif
      const floatN before_part = acc->a;
      composite_emission(acc, e, length * (place - passage.front), crosses);
#if WITH_DEPTH
      note_between(half_, before_part, acc->a, passage.front, place);
#endif
      const intN color_at = 4 * (surface + 1) + select((intN)4, (intN)0, rises);
      Vectors color = {AS_FLOAT(gather4(scene->items, color_at)), AS_FLOAT(gather4(scene->items, color_at + 1)),
                       AS_FLOAT(gather4(scene->items, color_at + 2))};
      const floatN opacity = AS_FLOAT(gather4(scene->items, 4 * surface + 1));
      const floatN left = select((floatN)0.0f, 1.0f - acc->a, crosses);
#if GRADIENT
      const Vectors gradient = scene_gradient(scene, at.x, at.y, at.z);
      const Vectors normal = directed3(gradient, -1.0f);
      const intN has_normal = crosses & MASK(dot3(normal, normal) > 0.5f);
      count_lanes(&counted[COUNT_GRADIENTS], crosses);
#if LIGHTING
      color = shaded_color(scene, color, (floatN)1.0f, at, normal, gradient, view, opacity * left, 1, has_normal, counted);
#endif
#endif
#if DEPTH_CUE
      color = cued_color(scene, color, (floatN)1.0f, ray->entry_depth + t * scene->view->march.x);
#endif
      count_lanes(&counted[COUNT_SURFACE_HITS], crosses);
      const floatN weight = left * opacity, before = acc->a;
      acc->r += weight * color.x, acc->g += weight * color.y, acc->b += weight * color.z;
      acc->a += weight;
#if WITH_DEPTH
      note_between(half_, before, acc->a, place, place);
#endif
      passage.front = select(passage.front, place, crosses);
#if REFRACTION
      const floatN index = AS_FLOAT(gather4(scene->items, 4 * surface + 2));
      const intN bends = has_normal & may_bend & MASK(index != 1.0f);
      if (any_lane(bends)) {
        const Vectors forward = scaled3(view, -1.0f);
        const Vectors against = select3(normal, scaled3(normal, -1.0f), MASK(dot3(normal, forward) > 0.0f));
        const floatN safe = select((floatN)1.0f, index, MASK(index > 0.0f));
        const Vectors bent = refracted(forward, against, select(safe, 1.0f / safe, rises));
        passage.bends |= bends, passage.at = select(passage.at, t, bends);
        passage.direction = select3(passage.direction, bent, bends);
        count_lanes(&counted[COUNT_BENDS], bends);
      }
#endif
    }
  }
  const intN rest = active & ~passage.bends;
  const floatN before_rest = acc->a;
  composite_emission(acc, e, length * (1.0f - passage.front), rest);
#if WITH_DEPTH
  note_between(half_, before_rest, acc->a, passage.front, (floatN)1.0f);
#endif
  return passage;
}

#endif
