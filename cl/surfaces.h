/* Iso-surfaces without polygons (Engel and Ertl 2002, section 10; Klein et al. 2005): where the reconstructed value
 * along a ray takes an iso-value (surface_walk.h), and what is seen there.
 *
 * The volume before, between and behind surfaces is composited in order: the segment is cut there.
 *
 * Three items per surface, iso-values ascending: (value, opacity, index of refraction, optical depth of that opacity),
 * front colour, back colour. Front is seen by a ray along which the value rises.
 */
#ifndef SURFACES_H
#define SURFACES_H

#include "bent_rays.h"
#include "composite.h"
#include "emission.h"
#include "half_opacity.h"
#include "owned_box.h"
#include "rays.h"
#include "scene.h"
#include "scene_value.h"
#include "skip_empty.h"
#if LIGHTING
#include "shade.h"
#endif
#if AMBIENT_OCCLUSION
#include "ambient_occlusion.h"
#endif
#if DEPTH_CUE
#include "depth_cue.h"
#endif
#if FIELDS
#include "fields.h"
#endif
#include "surface_walk.h"

#define MOST_BENDS 8

#if REFRACTION
/* The rays of `ray` (edges) from `at` on in another direction (local, unit length), to where they leave the volume. A
 * little way from the surface, so that they do not meet it again at once. */
#define BEYOND_SURFACE 2e-3f
INLINE Rays bent_rays(const Scene *scene, const Rays *ray, floatN at, Vectors direction)
{
  const Vectors place = {ray->x0 + at * ray->dx, ray->y0 + at * ray->dy, ray->z0 + at * ray->dz};
  return rays_from(scene, ray, place, ray->entry_depth + at, direction, BEYOND_SURFACE);
}
#endif

/* What happened to the rays of a packet in one segment. */
typedef struct {
  intN bends;        /* rays that go on in another direction */
  floatN at;         /* from where, in edges */
  Vectors direction; /* local, unit length */
  floatN first;      /* where a surface was the first to contribute, in edges */
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

/* The volume from `from` to `to` (edges), `length` steps, of which a step emits and absorbs `e`. */
INLINE void composite_stretch(Gathered *acc, Emission e, floatN length, floatN from, floatN to, intN active,
                              HalfBetween *half_)
{
#if WITH_DEPTH
  const floatN before = acc->a;
#endif
  composite_emission(acc, e, length, active);
#if WITH_DEPTH
  note_between(half_, before, acc->a, from, to);
#endif
}

/* The surfaces of a walk in one segment, from t0 to t1 in edges, `length` steps long, with the volume before, between
 * and behind them: `e` of a whole step, nothing unless `visible`. Lanes in `last`: nothing of the walk is left for
 * another segment. Of `active` lanes those that are not `owned` pass their surfaces without a trace (owned_box.h). */
INLINE SurfacePassage pass_surfaces(const Scene *scene, SurfaceWalk *walk, Vectors view, floatN t0, floatN t1,
                                    floatN length, Emission e, int visible, intN active, intN owned, intN last,
                                    intN may_bend, Gathered *acc, HalfBetween *half_, uintN *taken, Tally *counted)
{
  __constant const Effects *effects = scene->effects;
  const float steps = 1.0f / scene->view->step, enough = scene->view->stop_opacity;
  const floatN until = select(t1, (floatN)INFINITY, last);
  SurfacePassage passage;
  passage.bends = 0, passage.at = 0.0f, passage.first = INFINITY;
  passage.direction = scaled3(view, -1.0f);
  const floatN eye = walk->ray.entry_depth;
  floatN front = t0; /* so far is done */
  for (;;) {
    const intN wanted = active & ~passage.bends & MASK(acc->a < enough);
    find_surfaces(scene, walk, wanted, until, taken, &counted[COUNT_SURFACE_TESTS]);
    intN crosses = wanted & walk->found & MASK(walk->at <= until);
    if (!any_lane(crosses)) break;
    walk->found &= ~crosses;
    const Vectors at = surface_place(walk);
#if FIELDS & FIELD_MASK
    crosses = mask_keeps(scene, at.x, at.y, at.z, crosses, counted);
    if (!any_lane(crosses)) continue;
#endif
    const floatN place = select(front, lane_clamp(walk->at, front, t1), crosses);
#if OWNED_BOX
    const intN shown = crosses & (TRANSLUCENT ? owned : owns_front(scene->view, &walk->ray, walk->at));
#else
    const intN shown = crosses;
#endif
    if (visible) composite_stretch(acc, e, steps * (place - front), front, place, shown, half_);
    front = place;
    const intN surface = effects->first_surface + 3 * walk->surface;
    const intN color_at = 4 * (surface + 1) + select((intN)4, (intN)0, walk->rising);
    Vectors color = {AS_FLOAT(gather4(scene->items, color_at)), AS_FLOAT(gather4(scene->items, color_at + 1)),
                     AS_FLOAT(gather4(scene->items, color_at + 2))};
    const floatN opacity = AS_FLOAT(gather4(scene->items, 4 * surface + 1));
    const floatN left = select((floatN)0.0f, 1.0f - acc->a, shown);
#if GRADIENT
    const Vectors sloped = gradient_place(walk, at), gradient = scene_gradient(scene, sloped.x, sloped.y, sloped.z);
    const Vectors normal = directed3(gradient, -1.0f);
    const intN has_normal = crosses & MASK(dot3(normal, normal) > 0.5f);
    count_lanes(&counted[COUNT_GRADIENTS], crosses);
#if LIGHTING
    color = shaded_color(scene, color, (floatN)1.0f, at, normal, gradient, view, opacity * left, 1, has_normal,
                         counted);
#elif AMBIENT_OCCLUSION
    color = occluded_surface(scene, color, at, normal, has_normal);
#endif
#endif
#if DEPTH_CUE
    color = cued_color(scene, color, (floatN)1.0f, eye + walk->at);
#endif
    count_lanes(&counted[COUNT_SURFACE_HITS], crosses);
    const floatN weight = left * opacity;
    const floatN before = acc->a;
    acc->r += weight * color.x, acc->g += weight * color.y, acc->b += weight * color.z;
    acc->a += weight;
    passage.first = select(passage.first, place, MASK(before <= 0.0f) & MASK(acc->a > 0.0f));
#if WITH_DEPTH
    note_between(half_, before, acc->a, place, place);
#endif
#if REFRACTION
    const floatN index = AS_FLOAT(gather4(scene->items, 4 * surface + 2));
    const intN bends = has_normal & may_bend & MASK(index != 1.0f);
    if (any_lane(bends)) {
      const Vectors forward = scaled3(view, -1.0f);
      const Vectors against = select3(normal, scaled3(normal, -1.0f), MASK(dot3(normal, forward) > 0.0f));
      const floatN safe = select((floatN)1.0f, index, MASK(index > 0.0f));
      const Vectors bent = refracted(forward, against, select(safe, 1.0f / safe, walk->rising));
      passage.bends |= bends, passage.at = select(passage.at, walk->at, bends);
      passage.direction = select3(passage.direction, bent, bends);
      count_lanes(&counted[COUNT_BENDS], bends);
    }
#endif
  }
  const intN rest = owned & ~passage.bends;
  /* A segment without a surface is what it is without surfaces, bit for bit. */
  if (visible) composite_stretch(acc, e, select(steps * (t1 - front), length, MASK(front == t0)), front, t1, rest,
                                 half_);
  return passage;
}

#endif
