/* A packet of LANES rays through a scene whose effects change colours alone, not what a segment absorbs: lights,
 * shadows, clips, depth cueing, an environment. Segments and samples are those of march_effects.h, and so is every bit.
 *
 * MARCH_STEPS segments are taken in passes over arrays: all their samples, which wait for memory together
 * (march_plain.h); classification, and opacity from front to back, so that what is behind an opaque segment drops out;
 * gradients, light and colours of all that shows, some passes later (held_segments.h, lit_entries.h).
 *
 * Where the field is constant, gradient and light are nothing, and what a segment shows is known: rays whose packet is
 * in such cells (CONSTANT_CELLS; a map as in skip_empty.h, of the cells where the field or its gradient may change)
 * take one sample for all segments there, and composite as many as before. They are counted as samples all the same,
 * since each of them is composited as if it were one.
 */
#ifndef MARCH_SHADED_H
#define MARCH_SHADED_H

#include "classify.h"
#include "coherence.h"
#include "composite.h"
#include "emission.h"
#include "features.h"
#include "half_opacity.h"
#include "held_segments.h"
#include "lit_entries.h"
#include "march.h"
#include "packet_spans.h"
#include "rays.h"
#include "scene.h"
#include "scene_value.h"
#include "segment_queue.h"
#include "skip_empty.h"
#if CLIP
#include "clip.h"
#endif
#if ENVIRONMENT_VISIBLE
#include "background.h"
#endif

/* Whether values are needed at the ends of segments; else in their middle. */
#define NEEDS_ENDS (CLASSIFICATION == CLASSIFICATION_PREINTEGRATED)
#define MOST_STEPS 1e9f /* below 2^31 */

/* What a segment emits along which the value runs from `front` to `back`; of midpoints, both are that in its middle. */
INLINE Emission emission_between(floatN front, floatN back, intN active, __global const float *table,
                                 __constant const View *view)
{
#if NEEDS_ENDS
  return segment_emission_in(front, back, active, (intN)0, table, view);
#else
  return value_emission_in(back, (intN)0, table, view);
#endif
}

/* Where the value is taken of the segment that begins at `t0` of a ray of `length`. */
INLINE floatN sampled_at(floatN t0, floatN length)
{
  return NEEDS_ENDS ? lane_min(t0 + 1.0f, length) : segment_middle(t0, length);
}

#if CONSTANT_CELLS
#define CONSTANT_RUN 16 /* segments that are composited before it is seen whether a ray ends */

/* Composites segments that all emit `e`, of the rays in `active`, which have `steps` of them: as many as all have, up to
 * CONSTANT_RUN. None, where a ray would end among them, or more happens: its opacity begins, or passes one half.
 * Returns how many. */
INLINE int composite_constant(Gathered *acc, Emission e, intN active, intN steps, float stop_opacity)
{
  const int count = least_lane(select((intN)CONSTANT_RUN, min(steps, (intN)CONSTANT_RUN), active));
  const floatN none = 0.0f;
  const floatN r = select(none, e.r, active), g = select(none, e.g, active), b = select(none, e.b, active);
  const floatN d = select(none, e.d, active), before = acc->a;
  Gathered sum = *acc;
  _Pragma("unroll 1") for (int k = 0; k < count; ++k) {
    const floatN left = 1.0f - sum.a;
    sum.r += left * r, sum.g += left * g, sum.b += left * b, sum.a += left * d;
  }
  intN happens = MASK(sum.a >= stop_opacity) | MASK(before <= 0.0f);
#if WITH_DEPTH
  happens |= passes_half(before, sum.a);
#endif
  if (any_lane(active & happens)) return 0;
  *acc = sum;
  return count;
}
#endif

PER_PACKET void render_packet(const Scene *scene, intN px, intN py, Span span, float *rgba, float *depth, uint *samples,
                          Tally *counted FIRST_PARAMETER)
{
  __global const uchar *distances = scene->distances;
  __global const float *table = scene->table;
  __constant const View *view = scene->view;
  const float h = view->step;
  /* in edges: where clips cut depends on no step */
  const Rays whole_ray = make_rays_of_step(view, TO_FLOAT(px), TO_FLOAT(py), 1.0f);
  const Vectors forward = direction_to_local(scene->effects, whole_ray.dx, whole_ray.dy, whole_ray.dz);
  const intN on_picture = MASK(px < view->image.x) & MASK(py < view->image.y);
  intN alive = MASK(whole_ray.length >= 0.0f) & on_picture;
  BEGIN_FIRST(alive);
  uintN taken = 0;
  Gathered acc;
  gathered_clear(&acc);
  HalfOpacity half_ = no_half(); /* in edges from the eye */
  Rays ray = whole_ray;
  InnerSpan inner = inner_span(view, &ray);
  floatN next_from = 0.0f;  /* where the next stretch may begin, along whole_ray */
  Vectors cut_normal = {0.0f, 0.0f, 0.0f};
  intN i = 0, last = DONE;
  floatN visible_to = 0.0f; /* nothing is beyond: steps */
#if CONSTANT_CELLS
  floatN constant_to = 0.0f; /* from where the ray last asked to here, all is constant */
  intN constant_end = 0;     /* and segments before this one */
#endif
#if NEEDS_ENDS
  intN joined = 0;                     /* the values at the segment's start, and one step before, are known */
  floatN value1 = 0.0f, value2 = 0.0f; /* at the start of the segment, and one before */
#endif

  HeldSegments held;
  held.segments = held.entries = 0;
  int composites = 0; /* whether the next segments need the colours of all before */

  for (;;) {
    /* Rays at the end of a stretch go on to their next. */
    const intN stretches = alive & MASK(i > last);
    if (held.segments > MOST_HELD - MARCH_STEPS ||
        (held.segments && (composites | any_lane(stretches) | !any_lane(alive))))
      composite_held(scene, &held, &acc, &ray, inner, forward, cut_normal, counted);
    composites = 0;
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
      inner = inner_span(view, &ray);
      i = select(i, (intN)0, stretches);
      visible_to = ray.length;
#if (SPANS && !CLIP) || COHERENT
      floatN span_from;
      span_along(view, span, &ray, TO_FLOAT(px), TO_FLOAT(py), h, &span_from, &visible_to);
      visible_to = lane_min(visible_to, ray.length);
      /* One step before what may be visible: leaps begin where they would without a span. */
      i = select(i, TO_INT(lane_clamp(span_from - 1.0f, (floatN)0.0f, lane_max(ray.length, (floatN)0.0f))), stretches);
#endif
#if NEEDS_ENDS
      joined = select(joined, (intN)0, stretches);
#endif
      last = select(last, TO_INT(ceil(lane_max(ray.length, (floatN)0.0f))) - 1, stretches);
      alive &= found | ~stretches;
      last = select(last, (intN)DONE, ~alive);
    }
    if (!any_lane(alive)) break;
#if SKIP_EMPTY
    {
      /* Places depend by branches alone on what was shown before, as in march_plain.h. */
      const floatN t = TO_FLOAT(i);
      const Cells cells = cells_at(distances, view, t, &ray);
      const intN going = alive & MASK(i <= last);
      if (any_lane(going & (MASK(cells.distance > 0) | MASK(t >= visible_to)))) {
        const floatN visible_at = next_visible_from(cells, distances, view, t, visible_to, going, &ray, counted);
        /* The curvature of the first visible segment takes the sample before it. */
        const floatN most = TO_FLOAT(max(last, (intN)0)) + 1.0f;
        const intN next = TO_INT(lane_clamp(visible_at, (floatN)0.0f, most)) - NEEDS_ENDS;
        const intN leaps = going & MASK(next > i);
        i = select(i, next, leaps);
#if NEEDS_ENDS
        joined &= ~leaps;
#endif
        i = select(i, last + 1, going & MASK(visible_at >= ray.length));
      }
    }
#endif
#if CONSTANT_CELLS
    {
      const intN going = alive & MASK(i <= last);
      const floatN t0 = TO_FLOAT(i);
      const intN asks = going & MASK(t0 >= constant_to);
      if (any_lane(asks))
        constant_to = select(constant_to, next_visible(scene->constant_distances, view, t0, ray.length, asks, &ray,
                                                       counted), asks);
      /* Behind the last whole segment whose sample is there. */
      const floatN end = floor(lane_min(constant_to - (NEEDS_ENDS ? 1.0f : 0.5f), ray.length - 1.0f)) + 1.0f;
      constant_end = TO_INT(lane_clamp(end, (floatN)0.0f, (floatN)MOST_STEPS));
      intN leaves = going & MASK(i >= constant_end);
#if NEEDS_ENDS
      leaves |= going & ~(joined & MASK(value1 == value2));
      const floatN value = value1;
#endif
      if (any_lane(going) && !any_lane(leaves)) {
        if (held.segments) {
          composites = 1;
          continue;
        }
#if !NEEDS_ENDS
        const floatN t = segment_middle(t0, ray.length);
        const floatN value = scene_value(scene, ray.x0 + t * ray.dx, ray.y0 + t * ray.dy, ray.z0 + t * ray.dz);
#endif
        Emission e = no_emission();
        if (may_be_visible(value, value, going, view)) e = emission_between(value, value, going, table, view);
        for (intN active = going; any_lane(active) && !any_lane(active & MASK(i >= constant_end));
             active = alive & MASK(i <= last)) {
          const int count = composite_constant(&acc, e, active, min(last + 1, constant_end) - i, view->stop_opacity);
          if (count) {
            taken += AS_UINT(active & (intN)count), i += active & (intN)count;
            continue;
          }
          taken -= AS_UINT(active);
          const floatN left = select((floatN)0.0f, 1.0f - acc.a, active), before = acc.a;
          acc.r += left * e.r, acc.g += left * e.g, acc.b += left * e.b, acc.a += left * e.d;
          NOTE_FIRST(before, acc.a, ray.entry_depth + TO_FLOAT(i) * h);
#if WITH_DEPTH
          const intN passes = passes_half(before, acc.a);
          if (any_lane(passes))
            note_half(&half_, passes, before, ray.entry_depth + TO_FLOAT(i) * h, (floatN)1.0f, value, value);
#endif
          i -= active;
          last = select(last, (intN)DONE, MASK(acc.a >= view->stop_opacity));
          alive &= MASK(acc.a < view->stop_opacity);
        }
        continue;
      }
    }
#endif
    floatN values[MARCH_STEPS];
    const intN start = i;
#if BLOCKS
    values_of_segments(scene, &ray, start, last, NEEDS_ENDS, alive, values);
#elif FILTER == FILTER_LINEAR && VOXEL_BITS == 8 && !SAMPLE_REPEATS
    /* Three short loops: the one that fetches has all its fetches under way at once. Wider voxels gain nothing. */
    SamplePlace places[MARCH_STEPS];
    FetchedCorners corners[MARCH_STEPS];
    _Pragma("unroll 1") for (int step = 0; step < MARCH_STEPS; ++step) {
      const floatN t = sampled_at(TO_FLOAT(start + step), ray.length);
      places[step] = linear_place(scene->volume, view, ray.x0 + t * ray.dx, ray.y0 + t * ray.dy, ray.z0 + t * ray.dz);
    }
    _Pragma("unroll 1") for (int step = 0; step < MARCH_STEPS; ++step)
      corners[step] = fetch_corners_at(scene->volume, view, places[step].corner);
    _Pragma("unroll 1") for (int step = 0; step < MARCH_STEPS; ++step)
      values[step] = linear_value(fetched_at(places[step], corners[step]), view);
#else
    _Pragma("unroll 1") for (int step = 0; step < MARCH_STEPS; ++step) {
      const floatN t = sampled_at(TO_FLOAT(start + step), ray.length);
      values[step] = scene_value(scene, ray.x0 + t * ray.dx, ray.y0 + t * ray.dy, ray.z0 + t * ray.dz);
    }
#endif
#if NEEDS_ENDS
    /* No segment before had the sample where this one begins. */
    const intN unknown = alive & MASK(start <= last) & ~joined;
    if (any_lane(unknown)) {
      const floatN t = TO_FLOAT(start);
      value1 = select(value1, scene_value(scene, ray.x0 + t * ray.dx, ray.y0 + t * ray.dy, ray.z0 + t * ray.dz),
                      unknown);
      taken -= AS_UINT(unknown);
    }
#endif
    /* How many of these segments each ray takes, if it does not end before; and which can be visible. */
    intN steps = alive & max(min(last + 1 - start, (intN)MARCH_STEPS), (intN)0);
    uint shown[MARCH_STEPS], todo = 0, ended = 0;
#if NEEDS_ENDS
    floatN fronts[MARCH_STEPS];
#endif
    _Pragma("unroll 1") for (int step = 0; step < MARCH_STEPS; ++step) {
      const intN active = MASK(step < steps);
      const floatN t0 = TO_FLOAT(start + step), value = values[step];
#if NEEDS_ENDS
      const floatN length = select((floatN)1.0f, lane_min(t0 + 1.0f, ray.length) - t0, active);
      floatN front = value1, back = value;
      shift_ends(value2, &front, &back, length, active & MASK(joined != 0));
      value2 = select(value2, value1, active), value1 = select(value1, value, active);
      joined |= active;
      fronts[step] = front, values[step] = back;
#else
      const floatN front = value, back = value;
#endif
      shown[step] = lane_bits(active & lanes_that_show(lane_min(front, back), lane_max(front, back), view));
      todo |= (uint)(shown[step] != 0) << step;
    }
#if NEEDS_ENDS
#define FRONT(step) fronts[step]
#else
#define FRONT(step) values[step]
#endif
    while (todo) {
#if QUEUED_SEGMENTS
      SegmentQueue queue;
      QueuedColors colors;
      empty_queue(&queue);
      uint queued = 0;
      do {
        const uint next = todo & -todo;
        const int step = 31 - clz(next);
        shown[step] &= ~ended;
        if (queue.count + popcount(shown[step]) > LANES) break;
        append_segments(&queue, fronts[step], values[step], shown[step]);
        queued |= next, todo ^= next;
      } while (todo);
      colors_of_queue(&queue, table, view, &colors);
      int from = 0;
#else
      uint queued = todo & -todo;
      todo ^= queued;
#endif
      do {
        const uint next = queued & -queued;
        const int step = 31 - clz(next);
        const intN active = lanes_of(shown[step] & ~ended);
        queued ^= next;
#if QUEUED_SEGMENTS
        Emission e = emission_of_color(queued_color(&colors, shown[step], from));
        from += popcount(shown[step]);
#else
        Emission e = emission_between(FRONT(step), values[step], active, table, view);
#endif
        e.d = select((floatN)0.0f, e.d, active);
        intN shows = MASK(e.d > 0.0f);
        if (!any_lane(shows)) continue;
#if CONSTANT_CELLS
        shows &= MASK(start + step >= constant_end);
#endif
#if LIGHTING
        count_lanes(&counted[COUNT_GRADIENTS], shows);
#endif
        const floatN t0 = TO_FLOAT(start + step), before = acc.a;
        const floatN length = select((floatN)1.0f, lane_min(t0 + 1.0f, ray.length) - t0, active);
        hold_segment(&held, &acc, e, t0, length, active, shows);
        NOTE_FIRST(before, acc.a, ray.entry_depth + t0 * h);
#if WITH_DEPTH
        const intN passes = passes_half(before, acc.a);
        if (any_lane(passes))
          note_half(&half_, passes, before, ray.entry_depth + t0 * h, length, FRONT(step), values[step]);
#endif
        const intN ends = active & MASK(acc.a >= view->stop_opacity);
        if (any_lane(ends)) {
          ended |= lane_bits(ends);
          steps = select(steps, (intN)(step + 1), ends), last = select(last, (intN)DONE, ends), alive &= ~ends;
        }
      } while (queued);
    }
    taken += AS_UINT(steps);
    i += MARCH_STEPS; /* of rays that go on; for others it does not matter */
  }
#if ENVIRONMENT_VISIBLE
  show_environment(scene, forward, on_picture, &acc);
#endif
  gathered_store(&acc, rgba);
#if WITH_DEPTH && CLASSIFICATION == CLASSIFICATION_POST
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
