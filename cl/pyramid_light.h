/* Light on what the picture's pixels composite (pyramid_pixels.h): gradients in the middle of segments, of whatever length
 * these are, by the reconstruction that the ray caster has. None of them is synthesised: where samples are dense a picture
 * has the ray caster's light, and where they are far apart the oracle has found that light changes little along a segment
 * (oracle_cells.cl).
 *
 * Segments of a packet are held until its slices end, and lit a few vectors at a time (lit_entries.h), where lanes can be
 * packed and nothing changes what a segment absorbs (HELD_LIGHT); else one by one. A packet's ray is then what a ray of
 * the ray caster is: lengths count in steps from where it enters what is kept of the volume.
 */
#ifndef PYRAMID_LIGHT_H
#define PYRAMID_LIGHT_H

#include "composite.h"
#include "effects.h"
#include "features.h"
#include "lanes.h"
#include "opacity.h"
#include "pyramid.h"
#include "pyramid_packet.h"
#include "rays.h"
#include "scene.h"
#include "scene_value.h"
#include "transfer_pieces.h"
#include "vectors.h"
#if OPACITY_FACTORS
#include "opacity_factors.h"
#endif
#if ENVIRONMENT_VISIBLE
#include "background.h"
#endif

#if LANES > 1 && defined(HARDWARE_GATHER) && SEGMENT_OPACITIES
#define HELD_LIGHT 1
#include "lit_entries.h"
#else
#define HELD_LIGHT 0
#if LIGHTING
#include "shade.h"
#include "shown_normal.h"
#endif
#if DEPTH_CUE
#include "depth_cue.h"
#endif
#endif

/* A packet's rays as rays.h has them, from where they enter. */
INLINE Rays rays_of_packet(__constant const View *view, const PixelPacket *p)
{
  Rays r;
  const floatN enter = LOAD_LANES(p->enter);
  r.dx = LOAD_LANES(p->dx), r.dy = LOAD_LANES(p->dy), r.dz = LOAD_LANES(p->dz);
  r.x0 = LOAD_LANES(p->x0) + enter * r.dx, r.y0 = LOAD_LANES(p->y0) + enter * r.dy;
  r.z0 = LOAD_LANES(p->z0) + enter * r.dz;
  r.rx = finite_inverse(r.dx, &r.px), r.ry = finite_inverse(r.dy, &r.py), r.rz = finite_inverse(r.dz, &r.pz);
  r.length = INFINITY;
  r.entry_depth = view->plane_distance + enter * view->step;
  return r;
}

INLINE Vectors packet_forward(const Scene *scene, const Rays *ray)
{
  return unit3(direction_to_local(scene->effects, ray->dx, ray->dy, ray->dz));
}

/* Outwards of what is kept, where a clip cuts the ray before it enters; 0 elsewhere. */
INLINE Vectors packet_cut_normal(const Scene *scene, __constant const Pyramid *pyramid, const PixelPacket *p)
{
  Vectors normal = {0.0f, 0.0f, 0.0f};
#if CUT_FACES
  const intN cut = LOAD_LANES(p->cut);
  for (int j = 0; j < pyramid->half_count; ++j) {
    const float4 half_ = pyramid->halves[j];
    const Vectors inwards = gradient_to_local(scene->effects, half_.x, half_.y, half_.z);
    normal = select3(normal, scaled3(unit3(inwards), -1.0f), MASK(cut == j));
  }
#endif
  return normal;
}

#if HELD_LIGHT

/* Composites the opacity of a segment whose middle is on slice `middle`, and holds its colours. */
INLINE void hold_lit(HeldSegments *held, Gathered *acc, SegmentColor s, const PixelPacket *p, floatN middle, intN active,
                     Tally *counted)
{
  const Emission e = {s.r, s.g, s.b, select((floatN)0.0f, s.a, active)};
  const intN shows = MASK(e.d > 0.0f);
  if (!any_lane(shows)) return;
#if LIGHTING
  count_lanes(&counted[COUNT_GRADIENTS], shows);
#endif
  hold_segment(held, acc, e, middle - LOAD_LANES(p->enter) - 0.5f, (floatN)1.0f, active, shows);
}

/* Lights all that is held, and composites it. By itself: inlined into both ways through a chunk it takes compilers long. */
RARE void light_held(const Scene *scene, __constant const Pyramid *pyramid, HeldSegments *held, Gathered *acc,
                     const PixelPacket *p, Tally *counted)
{
  const Rays ray = rays_of_packet(scene->view, p);
  composite_held(scene, held, acc, &ray, inner_span(scene->view, &ray), packet_forward(scene, &ray),
                 packet_cut_normal(scene, pyramid, p), counted);
}

#else

/* Lights a segment whose middle is on slice `middle`; `left`: what arrives from there. Returns its optical depth. */
RARE floatN light_segment(const Scene *scene, __constant const Pyramid *pyramid, SegmentColor *s, const PixelPacket *p,
                          floatN middle, floatN left, intN active, Tally *counted)
{
  const Rays ray = rays_of_packet(scene->view, p);
  const Vectors forward = packet_forward(scene, &ray);
  const floatN t = middle - LOAD_LANES(p->enter);
  const Vectors place = {ray.x0 + t * ray.dx, ray.y0 + t * ray.dy, ray.z0 + t * ray.dz};
  intN shows = active & MASK(s->a > 0.0f);
  floatN depth = s->depth;
#if GRADIENT
  const Vectors gradient = scene_gradient(scene, place.x, place.y, place.z);
  count_lanes(&counted[COUNT_GRADIENTS], shows);
#endif
#if OPACITY_FACTORS
  const floatN whole = lane_min(depth, (floatN)OPAQUE_DEPTH), before = select((floatN)1.0f, s->a, shows);
  Emission e = {s->r / before, s->g / before, s->b / before, whole};
  weigh_by_gradient(scene, &e, gradient, forward);
  depth = e.d, s->a = opacity_of_depth(depth);
  s->r *= s->a / before, s->g *= s->a / before, s->b *= s->a / before;
  shows &= MASK(s->a > 0.0f);
#endif
  Vectors color = {s->r, s->g, s->b};
#if LIGHTING
  const Vectors normal = shown_normal(scene, gradient, packet_cut_normal(scene, pyramid, p), t * scene->view->step);
  const intN lit = shows & MASK(dot3(normal, normal) > 0.5f);
  color = shaded_color(scene, color, s->a, place, normal, gradient, scaled3(forward, -1.0f), left * s->a, 0, lit,
                       counted);
#endif
#if DEPTH_CUE
  color = cued_color(scene, color, s->a, ray.entry_depth + t * scene->view->step);
#endif
  s->r = color.x, s->g = color.y, s->b = color.z;
  return depth;
}

#endif

#if ENVIRONMENT_VISIBLE
/* What is left of the rays of the packet at (column, row) of the picture sees the environment. */
INLINE void show_behind(const Source *in, PixelPacket *p, int column, int row)
{
  __constant const View *view = in->view;
  const intN px = column + (LANE_INDEX & (PACKET_W - 1)), py = row + LANE_INDEX / PACKET_W;
  const Rays ray = rays_of_packet(view, p);
  Gathered acc;
  gathered_load(&acc, p->rgba);
  show_environment(in->scene, packet_forward(in->scene, &ray), MASK(px < view->image.x) & MASK(py < view->image.y),
                   &acc);
  gathered_store(&acc, p->rgba);
}
#endif

#endif
