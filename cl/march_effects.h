/* A packet of LANES rays through a scene with effects: emission and absorption as in march_plain.h, with what the
 * scene calls for.
 *
 * A ray's kept stretches (clip.h) are cut into segments one step long, the last one shorter, and the leaping and
 * masking are those of march_plain.h. What one segment emits and absorbs is kept in an array per channel (emission.h),
 * on which effects work in turn:
 *   opacity_factors.h  extinction weighted by the gradient and by the derivative along the ray, or from a function of
 *                      two values
 *   joint_layers.h     emission and extinction from a function of the values of several fields
 *   fields.h           further volumes: labels, densities, masks
 *   shade.h            lights, environment, shadows
 *   ambient_occlusion.h
 *   glow.h             light of associated colours
 *   depth cueing
 *   surfaces.h         iso-surfaces in the segment, in order with the volume before and behind them
 * Gradients are taken, and lights asked, only where a segment has opacity (LIGHTING, see cl/effects.h for what is
 * counted).
 */
#ifndef MARCH_EFFECTS_H
#define MARCH_EFFECTS_H

#include "classify.h"
#include "coherence.h"
#include "composite.h"
#include "emission.h"
#include "features.h"
#include "half_opacity.h"
#include "march.h"
#include "owned_box.h"
#include "packet_spans.h"
#include "rays.h"
#include "scene.h"
#include "scene_value.h"
#include "skip_empty.h"
#if CLIP
#include "clip.h"
#endif
#if LIGHTING
#include "shade.h"
#include "shown_normal.h"
#endif
#if AMBIENT_OCCLUSION
#include "ambient_occlusion.h"
#endif
#if DEPTH_CUE
#include "depth_cue.h"
#endif
#if OPACITY_FACTORS || TRANSFER_LAYERS
#include "opacity_factors.h"
#endif
#if FIELDS
#include "fields.h"
#endif
#if GLOW
#include "glow.h"
#endif
#if TRANSFER_LAYERS
#define GRADIENT_LAYERS (TRANSFER_LAYERS == LAYERS_BY_GRADIENT)
#if !GRADIENT_LAYERS
#include "joint_layers.h"
#endif
#else
#define GRADIENT_LAYERS 0
#endif
#if ISOSURFACES
#include "surfaces.h"
#endif
#if CURVED_RAYS
#include "curved_rays.h"
#endif
#if ENVIRONMENT_VISIBLE
#include "background.h"
#endif

/* Where along a segment values are needed. */
#define NEEDS_ENDS ((CLASSIFICATION == CLASSIFICATION_PREINTEGRATED) & (TRANSLUCENT != 0))
#define NEEDS_MIDDLE ((CLASSIFICATION != CLASSIFICATION_PREINTEGRATED) & (TRANSLUCENT != 0))

/* One sample per segment, at its middle or its end: it can be fetched ahead. */
#define SAMPLES_AHEAD (FETCH_AHEAD && CLASSIFICATION != CLASSIFICATION_PRE && TRANSLUCENT && !NOISE && !BLOCKS && !CURVED_RAYS)
#define AHEAD (CLASSIFICATION == CLASSIFICATION_POST ? 0.5f : 1.0f)

/* Values of blocks are taken for several segments at a time. */
#define VALUES_IN_RUNS (BLOCKS && TRANSLUCENT && !NOISE && !CURVED_RAYS)

/* Between looks at the map of empty space, and at where rays that turn go on. */
#if CURVED_RAYS
#define STRAIGHT_STEPS 1
#else
#define STRAIGHT_STEPS MARCH_STEPS
#endif

/* Where only surfaces show, a kept stretch is one segment. */
#define ONE_SEGMENT (ISOSURFACES && !TRANSLUCENT)

/* What is noted of a segment, `part` steps long, for the place where opacity reaches one half: its values, and more. */
#if CLASSIFICATION == CLASSIFICATION_PREINTEGRATED && TRANSLUCENT
#define SEGMENT_VALUES(first, second) const floatN first = a, second = b;
#else
#define SEGMENT_VALUES(first, second) const floatN first = mid, second = mid;
#endif
#if FIELDS && TRANSLUCENT
#define STEADY_SHARE (look_of_fields.added.d * look_of_fields.kept / select((floatN)1.0f, e.d, MASK(e.d > 0.0f)))
#else
#define STEADY_SHARE 0.0f
#endif
#if TRANSFER_LAYERS && TRANSLUCENT
#define NOTE_SEGMENT(passes, part)                         \
  note_whole(&half_, passes, e.d * (part), STEADY_SHARE); \
  note_layers(&half_, passes, layers);
#elif HALF_SCALED
#define NOTE_SEGMENT(passes, part) note_whole(&half_, passes, e.d * (part), STEADY_SHARE);
#else
#define NOTE_SEGMENT(passes, part)
#endif

/* Gradients are also reconstructed where nothing is lit, for what depends on them. */
#define GRADIENT_DECIDES (OPACITY_FACTORS || GRADIENT_LAYERS)

PER_PACKET void render_packet(const Scene *scene, intN px, intN py, Span span, float *rgba, float *depth, uint *samples,
                          Tally *counted FIRST_PARAMETER)
{
  __global const uchar *volume = scene->volume, *distances = scene->distances;
  __global const float *table = scene->table;
  __constant const View *view = scene->view;
  __constant const Effects *effects = scene->effects;
  const float h = view->step;
  /* in edges: where clips cut depends on no step */
  Rays whole_ray = make_rays_of_step(view, TO_FLOAT(px), TO_FLOAT(py), 1.0f);
  Vectors forward = direction_to_local(effects, whole_ray.dx, whole_ray.dy, whole_ray.dz);
  intN alive = MASK(whole_ray.length >= 0.0f) & MASK(px < view->image.x) & MASK(py < view->image.y);
  const intN on_picture = MASK(px < view->image.x) & MASK(py < view->image.y);
  BEGIN_FIRST(alive);
  uintN taken = 0;
  Gathered acc;
  gathered_clear(&acc);
  BEGIN_OPACITY(acc, depth);
  HalfOpacity half_ = no_half(); /* in edges from the eye */
  Rays ray = whole_ray;
  floatN next_from = 0.0f;  /* where the next stretch may begin, along whole_ray */
#if CLIP || LIGHTING
  Vectors cut_normal = {0.0f, 0.0f, 0.0f};
#endif
#if ISOSURFACES
  SurfaceWalk walk = walk_along(whole_ray, (floatN)0.0f);
#endif
#if REFRACTION
  intN bends_left = MOST_BENDS;
#endif
#if CURVED_RAYS
  intN turned = 0; /* rays that have turned */
  const floatN path_end = whole_ray.entry_depth + effects->longest_path;
#if !CLIP
  {
    const Vectors entry = {whole_ray.x0, whole_ray.y0, whole_ray.z0};
    turned = turn_rays(scene, entry, scene_value(scene, entry.x, entry.y, entry.z), 0.5f * h, alive, &forward, counted);
    taken -= AS_UINT(alive);
    const Rays bent = rays_from(scene, &whole_ray, entry, whole_ray.entry_depth, forward, 0.0f);
    whole_ray = select_rays(whole_ray, bent, turned);
    ray = whole_ray;
  }
#endif
#endif
  intN i = 0, last = DONE, joined = 0; /* joined: the values at the segment's start, and one step before, are known */
  floatN value1 = 0.0f, value2 = 0.0f; /* at the start of the segment, and one before */

  for (;;) {
    /* Rays at the end of a stretch go on to their next. */
    const intN stretches = alive & MASK(i > last);
    if (any_lane(stretches)) {
#if CLIP
      const Stretch next = next_stretch(scene, &whole_ray, next_from, 1.0f);
      const intN found = stretches & MASK(next.enter < next.leave);
      const Rays along = ray_along(&whole_ray, next.enter, next.leave, found, 1.0f);
      cut_normal = select3(cut_normal, next.normal, stretches);
      next_from = select(next_from, next.leave, found);
#else
      const intN found = stretches & MASK(next_from < whole_ray.length);
      const Rays along = whole_ray;
      next_from = select(next_from, whole_ray.length, stretches);
#endif
      ray = select_rays(ray, rays_in_steps(along, h), stretches);
      i = select(i, (intN)0, stretches), joined = select(joined, (intN)0, stretches);
      const floatN segments = ONE_SEGMENT ? (floatN)1.0f : ceil(lane_max(ray.length, (floatN)0.0f));
#if SPANS || COHERENT
      /* Of rays that are bent, starts are known up to there. A walk needs no step before its start. */
      floatN start_from, start_to;
      span_along(view, span, &ray, TO_FLOAT(px), TO_FLOAT(py), h, &start_from, &start_to);
#if REFRACTION
      start_from = select((floatN)0.0f, start_from, MASK(bends_left == MOST_BENDS));
#endif
#if CURVED_RAYS
      start_from = select(start_from, (floatN)0.0f, turned);
#endif
      start_from = lane_clamp(start_from - (ONE_SEGMENT ? 0.0f : 1.0f), (floatN)0.0f,
                              lane_max(ray.length, (floatN)0.0f));
      if (!ONE_SEGMENT) i = select(i, TO_INT(start_from), stretches);
#else
      const floatN start_from = 0.0f;
#endif
#if ISOSURFACES
      walk = select_walks(walk, walk_along(along, start_from * h), stretches);
#endif
      last = select(last, TO_INT(segments) - 1, stretches);
      alive &= found | ~stretches;
      last = select(last, (intN)DONE, ~alive);
    }
    if (!any_lane(alive)) break;
#if SKIP_EMPTY && !ONE_SEGMENT
    {
      const intN going = alive & MASK(i <= last);
      const floatN visible_at = next_visible(distances, view, TO_FLOAT(i), ray.length, going, &ray, counted);
      /* The curvature of the first visible segment takes the sample before it. */
      const intN next = TO_INT(lane_clamp(visible_at, (floatN)0.0f, TO_FLOAT(max(last, (intN)0)) + 1.0f)) - NEEDS_ENDS;
      const intN leaps = going & MASK(next > i);
      i = select(i, next, leaps), joined &= ~leaps;
      i = select(i, last + 1, going & MASK(visible_at >= ray.length));
    }
#endif
#if SAMPLES_AHEAD
    /* As in march_plain.h: a fetch from beyond the second-level cache takes longer than a step of arithmetic. */
    const floatN t_ahead = TO_FLOAT(i) + AHEAD;
    FetchedSample ahead = fetch_sample(volume, view, ray.x0 + t_ahead * ray.dx, ray.y0 + t_ahead * ray.dy,
                                       ray.z0 + t_ahead * ray.dz);
    FetchedSample ahead2 = fetch_sample(volume, view, ray.x0 + (t_ahead + 1.0f) * ray.dx,
                                        ray.y0 + (t_ahead + 1.0f) * ray.dy,
                                        ray.z0 + (t_ahead + 1.0f) * ray.dz);
#endif
#if ISOSURFACES && !ONE_SEGMENT
    /* All rays of the packet at once; in the segments only those that met a surface go on. */
    find_surfaces(scene, &walk, alive & MASK(i <= last), h * TO_FLOAT(i + MARCH_STEPS), &taken,
                  &counted[COUNT_SURFACE_TESTS]);
#endif
#if VALUES_IN_RUNS
    floatN values[MARCH_STEPS];
    values_of_segments(scene, &ray, i, last, NEEDS_ENDS, alive & MASK(i <= last), values);
#endif
    _Pragma("unroll 1") for (int step = 0; step < (ONE_SEGMENT ? 1 : STRAIGHT_STEPS); ++step) {
      const intN active = alive & MASK(i <= last);
      const floatN t0 = TO_FLOAT(i), t1 = ONE_SEGMENT ? ray.length : lane_min(t0 + 1.0f, ray.length);
      const floatN length = select((floatN)1.0f, t1 - t0, active), tm = t0 + 0.5f * length;
      const floatN xm = ray.x0 + tm * ray.dx, ym = ray.y0 + tm * ray.dy, zm = ray.z0 + tm * ray.dz;
      const int ends = NEEDS_ENDS, middle = NEEDS_MIDDLE;
      floatN front = value1, back = 0.0f, mid = 0.0f;
      Emission e = no_emission();
#if SAMPLES_AHEAD
      const FetchedSample sample = ahead;
      ahead = ahead2;
      const floatN t_next = t0 + (AHEAD + 2.0f);
      ahead2 = fetch_sample(volume, view, ray.x0 + t_next * ray.dx, ray.y0 + t_next * ray.dy, ray.z0 + t_next * ray.dz);
      floatN value = sample_value(sample, view);
      taken -= AS_UINT(active);
      /* What was fetched ahead belongs to a whole segment; and no segment before may have had the sample at its
       * start. */
      const intN shorter = active & MASK(length < 1.0f), unknown = NEEDS_ENDS ? active & ~joined : (intN)0;
      if (any_lane(shorter | unknown)) {
        _Pragma("unroll 1") for (int k = any_lane(unknown) ? 0 : 1; k < 2; ++k) {
          const floatN t = k == 0 ? t0 : NEEDS_ENDS ? t1 : tm;
          const floatN sampled = scene_value(scene, ray.x0 + t * ray.dx, ray.y0 + t * ray.dy, ray.z0 + t * ray.dz);
          if (k == 0) front = select(front, sampled, unknown), taken -= AS_UINT(unknown);
          if (k == 1) value = select(value, sampled, shorter);
        }
      }
      if (NEEDS_ENDS)
        back = value;
      else
        mid = value;
#else
      _Pragma("unroll 1") for (int k = ends && any_lane(active & ~joined) ? 0 : 1; k < 3; ++k) {
        if (!(k < 2 ? ends : middle)) continue;
        const floatN t = k == 0 ? t0 : k == 1 ? t1 : tm;
        const intN needed = k == 0 ? active & ~joined : active;
        const floatN x = ray.x0 + t * ray.dx, y = ray.y0 + t * ray.dy, z = ray.z0 + t * ray.dz;
#if CLASSIFICATION == CLASSIFICATION_PRE && TRANSLUCENT
        const FetchedSample sample = fetch_sample(volume, view, x, y, z);
        const floatN value = sample_value(sample, view);
        if (!TRANSFER_LAYERS && k == 2) e = classified_emission(sample, view, table);
#elif VALUES_IN_RUNS
        const floatN value = k ? values[step] : scene_value(scene, x, y, z);
#else
        const floatN value = scene_value(scene, x, y, z);
#endif
        taken -= AS_UINT(needed);
        if (k == 0) front = select(front, value, needed);
        if (k == 1) back = value;
        if (k == 2) mid = value;
      }
#endif
      const intN owned = active & owns_front(view, &ray, t0);
      int visible = 1;
#if !TRANSLUCENT
      visible = 0;
#elif CLASSIFICATION == CLASSIFICATION_PREINTEGRATED
      floatN a = front, b = back;
      shift_ends(value2, &a, &b, length, owned & MASK(joined != 0));
      visible = may_be_visible(lane_min(a, b), lane_max(a, b), owned, view);
      if (visible & (TRANSFER_LAYERS == 0)) e = segment_emission_in(a, b, owned, (intN)0, table, view);
#elif CLASSIFICATION == CLASSIFICATION_POST
      visible = may_be_visible(mid, mid, owned, view);
      if (visible & (TRANSFER_LAYERS == 0)) e = value_emission_in(mid, (intN)0, table, view);
#endif
#if TRANSLUCENT
#if TRANSFER_LAYERS
      intN shows = visible ? owned : (intN)0; /* what it emits depends on the gradient */
#else
      e.d = select((floatN)0.0f, e.d, owned);
      intN shows = MASK(e.d > 0.0f);
#endif
#if GLOW
      /* What emits need not absorb: such segments pass by all that changes what is absorbed. */
      Vectors light = {0.0f, 0.0f, 0.0f};
      intN glows = 0;
      if (visible) {
#if NEEDS_ENDS
        light = glow_between(scene, a, b, owned);
#else
        light = glow_between(scene, mid, mid, owned);
#endif
        glows = owned & (MASK(light.x > 0.0f) | MASK(light.y > 0.0f) | MASK(light.z > 0.0f));
      }
      shows |= glows;
#endif
#if FIELDS
      const FieldLook look_of_fields = look_at_fields(scene, &ray, t0, t1, xm, ym, zm, shows, owned, counted);
      shows = owned & (shows | MASK(look_of_fields.added.d > 0.0f)) & MASK(look_of_fields.kept > 0.0f);
#endif
      visible = any_lane(shows);
#if GRADIENT && ((LIGHTING && !LIT_AT_ENDS) || GRADIENT_DECIDES)
      Vectors gradient = {0.0f, 0.0f, 0.0f};
      if (visible) {
        gradient = scene_gradient(scene, xm, ym, zm);
        count_lanes(&counted[COUNT_GRADIENTS], shows);
      }
#endif
#if TRANSFER_LAYERS
      TablePlace layers = {0, 0, 0.0f, 0, 0.0f};
      if (visible) {
#if GRADIENT_LAYERS
        layers = layers_around(scene, gradient, view->function_floats);
#else
        layers = joint_layers(scene, xm, ym, zm, shows, view->function_floats, counted);
#endif
        Emission row = no_emission();
        _Pragma("unroll 1") for (int k = 0; k < LAYER_CORNERS; ++k) {
          const intN first = layer_corner(layers, k);
#if CLASSIFICATION == CLASSIFICATION_PREINTEGRATED
          const Emission layer = segment_emission_in(a, b, owned, first, table, view);
#elif CLASSIFICATION == CLASSIFICATION_POST
          const Emission layer = value_emission_in(mid, first, table, view);
#else
          const Emission layer = classified_emission_in(fetch_sample(volume, view, xm, ym, zm), view, first, table);
#endif
          row = k & 1 ? mixed_emission(row, layer, layers.share) : layer;
          if (k == 1) e = row;
          if (k == 3) e = mixed_emission(e, row, layers.row_share);
        }
      }
#endif
#if OPACITY_FACTORS
      if (visible) weigh_by_gradient(scene, &e, gradient, forward);
#if OPACITY_FACTORS & OPACITY_FACTOR_FUR
      if (visible) {
        const Vectors place = {xm, ym, zm};
#if NEEDS_ENDS
        weigh_by_fur(scene, &e, gradient, place, 0.5f * (a + b));
#else
        weigh_by_fur(scene, &e, gradient, place, mid);
#endif
      }
#endif
#endif
#if FIELDS
      if (visible)
        apply_fields(look_of_fields, &e);
      else
        e = no_emission();
#endif
#if FIELDS || GRADIENT_DECIDES || GLOW
      e.d = select((floatN)0.0f, e.d, owned);
      shows &= MASK(e.d > 0.0f);
      visible = any_lane(shows);
#endif
#if GLOW
#if FIELDS
      light = scaled3(light, look_of_fields.kept);
#endif
      visible |= any_lane(glows);
#endif
      if (visible) {
        Vectors color = {e.r, e.g, e.b};
#if LIT_AT_ENDS
        /* Light at both ends, weighed by where between them the segment shows (Lum, Wilson and Ma 2004). */
        const floatN weight = (1.0f - acc.a) * segment_opacity(e);
        const intN shorter = shows & MASK(length < 1.0f);
        floatN from_front = e.place;
        if (any_lane(shorter))
          from_front = select(from_front, place_in_segment(a, b, length, shorter, table, view), shorter);
        Vectors ends_lit[2];
        _Pragma("unroll 1") for (int end = 0; end < 2; ++end) {
          const floatN t_end = end ? t1 : t0;
          const Vectors place = {ray.x0 + t_end * ray.dx, ray.y0 + t_end * ray.dy, ray.z0 + t_end * ray.dz};
          const Vectors slope = scene_gradient(scene, place.x, place.y, place.z);
          count_lanes(&counted[COUNT_GRADIENTS], shows);
          const Vectors normal = shown_normal(scene, slope, cut_normal, t_end * h);
          const intN lit = shows & MASK(dot3(normal, normal) > 0.5f);
          ends_lit[end] = shaded_color(scene, color, e.d, place, normal, slope, scaled3(forward, -1.0f), weight, 0, lit,
                                       counted);
        }
        color.x = ends_lit[0].x + from_front * (ends_lit[1].x - ends_lit[0].x);
        color.y = ends_lit[0].y + from_front * (ends_lit[1].y - ends_lit[0].y);
        color.z = ends_lit[0].z + from_front * (ends_lit[1].z - ends_lit[0].z);
#elif LIGHTING
        const Vectors normal = shown_normal(scene, gradient, cut_normal, tm * h);
        const intN lit = shows & MASK(dot3(normal, normal) > 0.5f);
        const Vectors place = {xm, ym, zm};
        const floatN weight = (1.0f - acc.a) * segment_opacity(e);
        color = shaded_color(scene, color, e.d, place, normal, gradient, scaled3(forward, -1.0f), weight, 0, lit,
                             counted);
#elif AMBIENT_OCCLUSION
        const Vectors place = {xm, ym, zm};
        color = occluded_color(scene, color, place);
#endif
#if GLOW
        color = sum3(color, light);
#endif
#if DEPTH_CUE
        color = cued_color(scene, color, e.d, ray.entry_depth + tm * h);
#endif
        e.r = color.x, e.g = color.y, e.b = color.z;
      }
#endif
#if ISOSURFACES
      {
        intN may_bend = 0;
#if REFRACTION
        may_bend = MASK(bends_left > 0);
#endif
        const floatN from_edges = t0 * h, to_edges = ONE_SEGMENT ? walk.ray.length : t1 * h;
        HalfBetween between;
        between.from = INFINITY, between.to = between.before = 0.0f;
#if COHERENT
        const floatN before_segment = acc.a;
#endif
        const SurfacePassage passage = pass_surfaces(scene, &walk, scaled3(forward, -1.0f), from_edges, to_edges,
                                                     length, e, visible, active, owned, MASK(i == last), may_bend,
                                                     &acc, &between, &taken, counted);
#if WITH_DEPTH
        const intN passes = MASK(between.from < INFINITY);
        if (any_lane(passes)) {
          SEGMENT_VALUES(first, second)
          const intN uncut = MASK(between.from == from_edges) & MASK(between.to == to_edges);
          const floatN from = select((floatN)0.0f, between.from, passes);
          const floatN part = select((between.to - from) / h, length, uncut);
          const floatN slope = (second - first) / length, at = from / h - t0;
          note_half(&half_, passes, between.before, ray.entry_depth + from, part,
                    select(first + at * slope, first, uncut),
                    select(first + (at + part) * slope, second, uncut));
          NOTE_SEGMENT(passes, part)
        }
#endif
        NOTE_FIRST(before_segment, acc.a, ray.entry_depth + (ONE_SEGMENT ? passage.first : t0 * h));
        last = select(last, (intN)DONE, MASK(acc.a >= view->stop_opacity));
        alive &= MASK(acc.a < view->stop_opacity);
#if REFRACTION
#if COHERENT
        *first = select(*first, ray.entry_depth + passage.at, passage.bends & MASK(*first == INFINITY));
#endif
        if (any_lane(passage.bends)) {
          const Rays bent = bent_rays(scene, &walk.ray, passage.at, passage.direction);
          whole_ray = select_rays(whole_ray, bent, passage.bends);
          forward = select3(forward, passage.direction, passage.bends);
          next_from = select(next_from, (floatN)0.0f, passage.bends);
          last = select(last, (intN)DONE, passage.bends), i = select(i, (intN)0, passage.bends);
          bends_left += passage.bends;
        }
#endif
      }
#else
      if (visible) {
        const floatN before = acc.a;
        composite_emission(&acc, e, length, owned);
        NOTE_FIRST(before, acc.a, ray.entry_depth + t0 * h);
#if WITH_DEPTH
        const intN passes = passes_half(before, acc.a);
        if (any_lane(passes)) {
          SEGMENT_VALUES(first, second)
          note_half(&half_, passes, before, ray.entry_depth + t0 * h, length, first, second);
          NOTE_SEGMENT(passes, length)
        }
#endif
        last = select(last, (intN)DONE, MASK(acc.a >= view->stop_opacity));
        alive &= MASK(acc.a < view->stop_opacity);
      }
#endif
#if CURVED_RAYS
      /* Whole steps end where rays turn; what stays straight goes on as if there were no index. */
      const intN goes_on = alive & MASK(i < last) & MASK(ray.entry_depth + t1 * h < path_end);
      if (any_lane(goes_on)) {
        const Vectors place = {ray.x0 + t1 * ray.dx, ray.y0 + t1 * ray.dy, ray.z0 + t1 * ray.dz};
        floatN here = back;
        if (!NEEDS_ENDS) here = scene_value(scene, place.x, place.y, place.z), taken -= AS_UINT(goes_on);
        const intN turns = turn_rays(scene, place, here, h, goes_on, &forward, counted);
        if (any_lane(turns)) {
          const Rays bent = rays_from(scene, &whole_ray, place, ray.entry_depth + t1 * h, forward, 0.0f);
          whole_ray = select_rays(whole_ray, bent, turns);
          next_from = select(next_from, (floatN)0.0f, turns);
          last = select(last, (intN)DONE, turns), i = select(i, (intN)0, turns);
          turned |= turns;
        }
      }
#endif
      if (ends) {
        value2 = select(value2, front, active), value1 = select(value1, back, active);
        joined |= active;
      } else
        joined &= ~active;
      i -= active;
    }
  }
#if ENVIRONMENT_VISIBLE
  show_environment(scene, forward, on_picture, &acc);
#endif
  gathered_store(&acc, rgba);
#if WITH_DEPTH && CLASSIFICATION == CLASSIFICATION_POST && TRANSLUCENT && !REFRACTION && !TRANSFER_LAYERS && !CURVED_RAYS
  const intN noted = MASK(half_.from < INFINITY) & MASK(half_.length > 0.0f);
  if (any_lane(noted)) {
    floatN ends[2];
    _Pragma("unroll 1") for (int k = 0; k < 2; ++k) {
      const floatN along = (half_.from - ray.entry_depth) * (1.0f / h) + (k ? half_.length : (floatN)0.0f);
      const floatN t = select((floatN)0.0f, along, noted);
      const floatN value = scene_value(scene, ray.x0 + t * ray.dx, ray.y0 + t * ray.dy, ray.z0 + t * ray.dz);
      ends[k] = depth_between(value, value, noted, (intN)0, table, view);
      taken -= AS_UINT(noted);
    }
    note_ends(&half_, ends[0], ends[1]);
  }
#endif
#if WITH_DEPTH
  STORE_LANES(half_place(&half_, h, table, view) * view->edge_length, depth);
#endif
  STORE_LANES(taken, samples);
}

#endif
