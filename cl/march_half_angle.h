/* A packet of LANES rays through the slabs of half-angle slices (half_angle.h), front to back: emission and absorption
 * as in march_effects.h, of lit samples, each in the middle of what the ray passes of a slab. Slabs end at the volume's
 * faces and at clips. There are no surfaces and fields.
 *
 * CLASSIFICATION pre and post: by the value in the middle. preintegrated: along the chord between the values where the
 * ray enters the slab and leaves it; chords are not corrected for curvature.
 */
#ifndef MARCH_HALF_ANGLE_H
#define MARCH_HALF_ANGLE_H

#include "classify.h"
#include "composite.h"
#include "emission.h"
#include "features.h"
#include "half_opacity.h"
#include "march.h"
#include "packet_spans.h"
#include "rays.h"
#include "scene.h"
#include "scene_value.h"
#include "skip_empty.h"
#include "slice_light.h"
#if CLIP
#include "clip.h"
#endif
#if LIGHTING
#include "shade.h"
#endif
#if DEPTH_CUE
#include "depth_cue.h"
#endif

PER_PACKET void render_packet(const Scene *scene, intN px, intN py, Span span, float *rgba, float *depth, uint *samples,
                          Tally *counted)
{
  __global const float *table = scene->table;
  __constant const View *view = scene->view;
  __constant const Effects *effects = scene->effects;
  const float h = view->step;
  const Rays ray = make_rays(view, TO_FLOAT(px), TO_FLOAT(py));
  const Vectors entry = {ray.x0, ray.y0, ray.z0}, direction = {ray.dx, ray.dy, ray.dz};
  const RaySlabs slabs = slabs_of(scene->half_angle, entry, direction);
  const Vectors forward = scaled3(direction_to_local(effects, ray.dx, ray.dy, ray.dz), 1.0f / h);
  intN alive = MASK(ray.length > 0.0f) & MASK(px < view->image.x) & MASK(py < view->image.y);
  uintN taken = 0;
  Gathered acc;
  gathered_clear(&acc);
  HalfOpacity half_ = no_half(); /* in edges from the eye */
  floatN from = 0.0f;            /* all before is done; in steps */
#if CLASSIFICATION == CLASSIFICATION_PREINTEGRATED
  floatN known = 0.0f; /* the value there, */
  intN joined = 0;     /* of these lanes */
#endif
#if SKIP_EMPTY
  floatN clear_to = -1.0f; /* nothing is visible before */
#endif
#if CLIP
  Stretch kept;
  kept.enter = -1.0f, kept.leave = 0.0f;
  kept.normal.x = kept.normal.y = kept.normal.z = 0.0f;
#endif

  for (int i = 0; i <= scene->half_angle->size.z; ++i) {
    alive &= MASK(from < ray.length);
    if (!any_lane(alive)) break;
    const floatN slab_ends = slabs.end + (float)i * slabs.gap;
    const floatN ends = i == scene->half_angle->size.z ? ray.length : lane_min(slab_ends, ray.length);
    intN open = alive & MASK(from < ends);
    while (any_lane(open)) {
#if CLIP
      const intN behind = open & MASK(kept.leave <= from);
      if (any_lane(behind)) {
        const Stretch next = next_stretch(scene, &ray, lane_max(kept.leave, (floatN)0.0f), h);
        const intN found = behind & MASK(next.enter < next.leave);
        kept.enter = select(kept.enter, next.enter, found), kept.leave = select(kept.leave, next.leave, found);
        kept.normal = select3(kept.normal, next.normal, found);
        alive &= found | ~behind, open &= alive;
        from = select(from, lane_max(from, kept.enter), found);
#if CLASSIFICATION == CLASSIFICATION_PREINTEGRATED
        joined &= ~behind;
#endif
      }
      const floatN a = from, b = lane_min(ends, kept.leave);
#else
      const floatN a = from, b = ends;
#endif
      intN active = open & MASK(a < b);
      from = select(from, b, active);
      open = active & MASK(from < ends);
#if SKIP_EMPTY
      const intN look = active & MASK(clear_to <= a);
      if (any_lane(look))
        clear_to = select(clear_to, next_visible(scene->distances, view, a, ray.length, look, &ray, counted), look);
      const intN empty = active & MASK(clear_to >= b);
      active &= ~empty;
#if CLASSIFICATION == CLASSIFICATION_PREINTEGRATED
      joined &= ~empty;
#endif
      if (!any_lane(active)) continue;
#endif
      const floatN length = select((floatN)1.0f, b - a, active), tm = 0.5f * (a + b);
      const floatN xm = ray.x0 + tm * ray.dx, ym = ray.y0 + tm * ray.dy, zm = ray.z0 + tm * ray.dz;
      Emission e = no_emission();
#if CLASSIFICATION == CLASSIFICATION_PREINTEGRATED
      floatN first = known, second = 0.0f;
      const intN unknown = active & ~joined;
      _Pragma("unroll 1") for (int k = any_lane(unknown) ? 0 : 1; k < 2; ++k) {
        const floatN t = k ? b : a;
        const floatN value = scene_value(scene, ray.x0 + t * ray.dx, ray.y0 + t * ray.dy, ray.z0 + t * ray.dz);
        taken -= AS_UINT(k ? active : unknown);
        if (k == 0)
          first = select(first, value, unknown);
        else
          second = value;
      }
      known = select(known, second, active), joined |= active;
      if (may_be_visible(lane_min(first, second), lane_max(first, second), active, view))
        e = segment_emission_in(first, second, active, (intN)0, table, view);
#else
      taken -= AS_UINT(active);
#if CLASSIFICATION == CLASSIFICATION_PRE
      const floatN first = 0.0f, second = 0.0f;
      e = classified_emission(fetch_sample(scene->volume, view, xm, ym, zm), view, table);
#else
      const floatN first = scene_value(scene, xm, ym, zm), second = first;
      if (may_be_visible(first, first, active, view)) e = value_emission_in(first, (intN)0, table, view);
#endif
#endif
      e.d = select((floatN)0.0f, e.d, active);
      const intN shows = MASK(e.d > 0.0f);
      if (!any_lane(shows)) continue;
      Vectors color = {e.r, e.g, e.b};
#if LIGHTING
      const Vectors gradient = scene_gradient(scene, xm, ym, zm);
      count_lanes(&counted[COUNT_GRADIENTS], shows);
      Vectors normal = directed3(gradient, -1.0f);
#if CLIP
      /* A cut face shows its own normal, going over to the gradient's within one edge. */
      const floatN inside = lane_clamp((tm - kept.enter) * h, (floatN)0.0f, (floatN)1.0f);
      const intN cut = MASK(dot3(kept.normal, kept.normal) > 0.5f) & MASK(inside < 1.0f);
      if (any_lane(cut)) {
        const intN two_sided = effects->two_sided ? (intN)-1 : (intN)0;
        const intN turned = two_sided & MASK(dot3(normal, kept.normal) < 0.0f);
        const Vectors toward = select3(normal, scaled3(normal, -1.0f), turned);
        normal = select3(normal, unit3(sum3(scaled3(toward, inside), scaled3(kept.normal, 1.0f - inside))), cut);
      }
#endif
      const intN lit = shows & MASK(dot3(normal, normal) > 0.5f);
      const Vectors place = {xm, ym, zm};
      const floatN weight = (1.0f - acc.a) * opacity_of_depth(e.d * length);
      color = shaded_color(scene, color, e.d, place, normal, gradient, scaled3(forward, -1.0f), weight, 0, lit,
                           counted);
#endif
#if DEPTH_CUE
      color = cued_color(scene, color, e.d, ray.entry_depth + tm * h);
#endif
      e.r = color.x, e.g = color.y, e.b = color.z;
      const floatN before = acc.a;
      composite_emission(&acc, e, length, active);
#if WITH_DEPTH
      const intN passes = passes_half(before, acc.a);
      note_half(&half_, passes, before, ray.entry_depth + a * h, length, first, second);
      note_whole(&half_, passes, e.d * length, 0.0f);
#endif
      alive &= MASK(acc.a < view->stop_opacity);
      open &= alive;
    }
  }
  gathered_store(&acc, rgba);
#if WITH_DEPTH
  STORE_LANES(half_place(&half_, h, table, view) * view->edge_length, depth);
#endif
  STORE_LANES(taken, samples);
}

#endif
