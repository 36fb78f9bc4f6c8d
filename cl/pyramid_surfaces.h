/* Iso-surfaces of the picture's pixels (pyramid_pixels.h): each ray has its walk (surface_walk.h), whatever its level and
 * however far apart its samples are. So a surface is where the ray caster has it, and is shaded as there.
 *
 * A surface is an edge in what is composited, which no samples beside it can tell of. So nothing is synthesised across one:
 * where a ray meets a surface, its segment is sampled on every slice in between, and composited as the ray caster
 * composites steps, by the same function. What is looked for is the next surface, up to the end of a chunk of slices;
 * a ray that has none there does what it does without surfaces. Where columns sleep surfaces are met in empty space, and
 * where nothing but surfaces shows all of a ray is such.
 */
#ifndef PYRAMID_SURFACES_H
#define PYRAMID_SURFACES_H

#include "classify.h"
#include "composite.h"
#include "emission.h"
#include "features.h"
#include "half_opacity.h"
#include "lanes.h"
#include "pyramid.h"
#include "pyramid_light.h"
#include "pyramid_packet.h"
#include "pyramid_places.h"
#include "pyramid_rays.h"
#include "rays.h"
#include "surfaces.h"
#include "tally.h"
#include "transfer_pieces.h"
#include "vectors.h"

/* Slice `t` as a place of a packet's walk, in edges from where its rays enter; and back. */
INLINE floatN edges_at(const Source *in, const PixelPacket *p, floatN t)
{
  return (t - LOAD_LANES(p->enter)) * in->view->step;
}
INLINE floatN slice_of(const Source *in, const PixelPacket *p, floatN edges)
{
  return LOAD_LANES(p->enter) + edges / in->view->step;
}

/* The walk of the packet of the pixels (px, py), whose rays meet the hull at slices `hull` and are cut by clips to
 * `r`: the ray caster's, from the same numbers. */
INLINE void begin_walk(__constant const View *view, PixelPacket *p, intN px, intN py, const SliceRays *r, floatN hull)
{
  Rays ray = make_rays_of_step(view, TO_FLOAT(px), TO_FLOAT(py), 1.0f);
  const floatN start = (r->enter - hull) * view->step;
  const intN cut = MASK(start > 0.0f);
  ray.x0 = select(ray.x0, ray.x0 + start * ray.dx, cut), ray.y0 = select(ray.y0, ray.y0 + start * ray.dy, cut);
  ray.z0 = select(ray.z0, ray.z0 + start * ray.dz, cut);
  ray.entry_depth = select(ray.entry_depth, ray.entry_depth + start, cut);
  const floatN kept = (r->leave - r->enter) * view->step;
  /* Cut behind, too, but for rounding. */
  ray.length = select(ray.length, kept, cut | MASK(kept < ray.length - 1e-3f));
  p->walk = walk_along(ray, (floatN)0.0f);
}

/* Where (slices) the packet's rays meet their next surface, as far as is known; INFINITY: none. */
INLINE floatN next_surface(const Source *in, const PixelPacket *p)
{
  const floatN at = lane_min(slice_of(in, p, p->walk.at), LOAD_LANES(p->leave));
  return select((floatN)INFINITY, at, p->walk.found);
}

/* Looks for the next surface of the rays `alive` that is met before slice `until`, if it is not known. */
INLINE void look_ahead(const Source *in, PixelPacket *p, intN alive, float until, Tally *samples, Tally *counted)
{
  const intN ends = MASK(LOAD_LANES(p->leave) <= until);
  const floatN edges = select(edges_at(in, p, (floatN)until), (floatN)INFINITY, ends);
  if (!any_lane(alive & ~p->walk.found & MASK(p->walk.from < edges))) return;
  uintN taken = 0;
  find_surfaces(in->scene, &p->walk, alive, edges, &taken, &EFFECT_TALLIES(counted)[COUNT_SURFACE_TESTS]);
  *samples += taken;
}

/* The surfaces of the rays `active` between slices `from` and `to`, with the volume around them, of which a step emits
 * and absorbs `e` if it is `visible`. `front` and `back`: the values at both ends. */
INLINE void pass_slices(const Source *in, PixelPacket *p, Gathered *acc, floatN from, floatN to, Emission e, int visible,
                        floatN front, floatN back, intN active, Tally *samples, Tally *counted)
{
  const Scene *scene = in->scene;
  const floatN from_edges = edges_at(in, p, from), to_edges = edges_at(in, p, to), length = to - from;
  const Rays *ray = &p->walk.ray;
  const Vectors forward = direction_to_local(scene->effects, ray->dx, ray->dy, ray->dz);
  const intN last = MASK(to >= LOAD_LANES(p->leave));
  uintN taken = 0;
  HalfBetween between;
  between.from = INFINITY, between.to = between.before = 0.0f;
  pass_surfaces(scene, &p->walk, scaled3(forward, -1.0f), from_edges, to_edges, length, e, visible, active, active, last,
                (intN)0, acc, &between, &taken, EFFECT_TALLIES(counted));
  *samples += taken;
#if WITH_DEPTH
  const intN passes = MASK(between.from < INFINITY);
  if (any_lane(passes)) {
    const intN uncut = MASK(between.from == from_edges) & MASK(between.to == to_edges);
    const floatN at = select((floatN)0.0f, between.from, passes), steps = 1.0f / in->view->step;
    const floatN part = select((between.to - at) * steps, length, uncut), before = (at - from_edges) * steps;
    const floatN slope = (back - front) / select((floatN)1.0f, length, passes);
    note_half(&p->half_, passes, between.before, select(slice_of(in, p, at), from, uncut), part,
              select(front + before * slope, front, uncut), select(front + (before + part) * slope, back, uncut));
    note_whole(&p->half_, passes, e.d * part, 0.0f);
  }
#endif
}

/* The surfaces that the rays `active` meet in empty space, up to slice `until`. Returns whether any ray goes on. */
RARE int pass_empty_slices(const Source *in, PixelPacket *p, float until, Tally *samples, Tally *counted)
{
  intN alive = LOAD_LANES(p->alive);
  look_ahead(in, p, alive, until, samples, counted);
  const floatN leave = LOAD_LANES(p->leave), to = lane_min((floatN)until, leave);
  const intN meets = alive & MASK(next_surface(in, p) <= to);
  if (!any_lane(meets)) return any_lane(alive);
  Gathered acc;
  gathered_load(&acc, p->rgba);
  const floatN enter = LOAD_LANES(p->enter), none = 0.0f;
  pass_slices(in, p, &acc, enter, lane_max(to, enter), no_emission(), 0, none, none, meets, samples, counted);
  gathered_store(&acc, p->rgba);
  STORE_LANES(acc.a, p->opacity);
  alive &= MASK(acc.a < in->view->stop_opacity);
  STORE_LANES(alive, p->alive);
  return any_lane(alive);
}

/* A ray's last samples: values (and slices), the last one 1. `curved`: both are there. */
typedef struct {
  floatN value1, value2, t1, t2;
  intN curved;
} LastSamples;

/* Closes segments of the rays `active` that end at slices `t` with `value`, and in which there are surfaces. */
RARE void close_at_surfaces(const Source *in, PixelPacket *p, Gathered *acc, const LastSamples *last, floatN t,
                            floatN value, intN active, __global const float *table, Tally *samples, Tally *counted)
{
  __constant const View *view = in->view;
  const floatN one = 1.0f;
  const floatN x0 = LOAD_LANES(p->x0), y0 = LOAD_LANES(p->y0), z0 = LOAD_LANES(p->z0);
  const floatN dx = LOAD_LANES(p->dx), dy = LOAD_LANES(p->dy), dz = LOAD_LANES(p->dz);
  floatN from = last->t1, front = last->value1, before = last->value2, way_before = last->t1 - last->t2;
  intN open = active, curved = last->curved;
  while (any_lane(open)) {
    const floatN to = lane_min(floor(from) + 1.0f, t);
    const intN refined = open & MASK(to < t);
    floatN back = value;
    if (any_lane(refined)) {
      const FetchedPlace fetched = fetch_place(in, x0 + to * dx, y0 + to * dy, z0 + to * dz, refined, 0);
      back = select(back, place_value(in, &fetched), refined);
      count_lanes(samples, refined);
    }
    const floatN length = select(one, to - from, open);
    floatN a = front, b = back;
    shift_uneven_ends(before, &a, &b, select(one, way_before, curved), length, open & curved);
    const int visible = may_be_visible(lane_min(a, b), lane_max(a, b), open, view);
    Emission e = no_emission();
    if (visible) {
      SegmentColor step = color_of_segment(a, b, (floatN)view->step_units, open, scene_pieces(table, (intN)0, view));
      step.depth = light_segment(in->scene, in->pyramid, &step, p, from + 0.5f * length, 1.0f - acc->a, open,
                                 EFFECT_TALLIES(counted));
      e = emission_of_color(step);
      e.d = select((floatN)0.0f, e.d, open);
    }
    pass_slices(in, p, acc, from, select(from, to, open), e, visible, a, b, open, samples, counted);
    before = select(before, front, open), front = select(front, back, open);
    way_before = select(way_before, length, open), from = select(from, to, open), curved |= open;
    open &= MASK(to < t) & MASK(acc->a < view->stop_opacity);
  }
}

#endif
