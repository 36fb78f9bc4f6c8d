/* A packet of LANES rays from front to back, as march_plain.h, but with segments of one or more steps: as many as the map
 * `steps` allows where a segment begins (clvol/integrators/raycast/step_map.py says what it allows). All segments are
 * whole steps from the ray's entry; the ray's last piece is shorter than a step, as in march_plain.h. Under the linear
 * filter alone, classified by post or preintegrated.
 *
 * The number of steps is known before the volume is sampled.
 */
#ifndef MARCH_STEPS_H
#define MARCH_STEPS_H

#include "along_rays.h"
#include "classify.h"
#include "features.h"
#include "half_opacity.h"
#include "march.h"
#include "packet_spans.h"
#include "rays.h"
#include "scene.h"
#include "skip_empty.h"
#include "skip_steps.h"

/* Steps that a segment may have that begins at `at`, at most up to `last`. */
INLINE intN steps_from(__global const uchar *steps, __constant const View *view, const Rays *ray, intN at, intN last)
{
  const floatN t = TO_FLOAT(at);
  const intN cx = TO_INT(lane_clamp(ray->x0 + t * ray->dx, (floatN)0.0f, (floatN)view->upper.x)) >> STEP_CELLS;
  const intN cy = TO_INT(lane_clamp(ray->y0 + t * ray->dy, (floatN)0.0f, (floatN)view->upper.y)) >> STEP_CELLS;
  const intN cz = TO_INT(lane_clamp(ray->z0 + t * ray->dz, (floatN)0.0f, (floatN)view->upper.z)) >> STEP_CELLS;
  const int columns = ((view->size.x - 1) >> STEP_CELLS) + 1, rows = ((view->size.y - 1) >> STEP_CELLS) + 1;
  const intN most = AS_INT(gather1(steps, (cz * rows + cy) * columns + cx) & 255u);
  return max(min(most, last - at), (intN)1);
}

PER_PACKET void render_packet(const Scene *scene, intN px, intN py, Span span, float *rgba, float *depth, uint *samples,
                          Tally *counted)
{
  __global const uchar *volume = scene->volume, *distances = scene->distances, *steps = scene->steps;
  __global const float *table = scene->table;
  __constant const View *view = scene->view;
  const Rays ray = make_rays(view, TO_FLOAT(px), TO_FLOAT(py));
  const floatN whole = floor(ray.length), rest = ray.length - whole;
  const intN hits = MASK(ray.length >= 0.0f) & MASK(px < view->image.x) & MASK(py < view->image.y);
  const intN end = select((intN)DONE, TO_INT(whole), hits); /* whole steps */
  /* The place that comes next: of midpoints, where its segment begins. */
  intN last = select((intN)DONE, end - MIDPOINTS, hits);
  floatN span_from, span_to;
  span_along(view, span, &ray, TO_FLOAT(px), TO_FLOAT(py), view->step, &span_from, &span_to);
  span_to = lane_min(span_to, ray.length);
  /* One step before what may be visible: leaps begin where they would without a span. */
  intN i = TO_INT(lane_clamp(span_from - 1.0f, (floatN)0.0f, TO_FLOAT(max(last, (intN)0))));
  uintN taken = 0;
  Gathered acc;
  gathered_clear(&acc);
  HalfOpacity half_ = no_half(); /* in steps */
  floatN value1 = 0.0f, value2 = 0.0f;   /* the last sample and the one before */
  intN before1 = 0, before2 = 0;         /* steps from the last sample to place i, and from the one before to the last */
  intN run = 0;                          /* samples since the last leap, up to 2 */

  while (any_lane(MASK(i <= last))) {
#if SKIP_EMPTY
#if MIDPOINTS
    const floatN from = TO_FLOAT(i) + 0.5f;
#else
    const floatN from = TO_FLOAT(i - select((intN)0, before1, MASK(run > 0)) - select((intN)0, before2, MASK(run > 1)));
#endif
    const Cells cells = cells_at(distances, view, from, &ray);
    if (any_lane(MASK(i <= last) & (MASK(cells.distance > 0) | MASK(from >= span_to)))) {
      const intN leaps = leap_along(cells, distances, view, from, span_to, &ray, &i, &last, counted);
      run = select(run, (intN)0, leaps);
    }
#endif
    /* Places depend by branches alone on what the steps before have shown, as in march_plain.h. First all samples, then
     * what they show: so short a loop has many steps under way at once, and none of them waits for the cache alone. */
    floatN values[MARCH_STEPS];
    intN counts[MARCH_STEPS], at = i;
    UNROLL_LANES for (int step = 0; step < MARCH_STEPS; ++step) {
      const intN n = steps_from(steps, view, &ray, at, end);
      const floatN t = TO_FLOAT(at) + (MIDPOINTS ? 0.5f * TO_FLOAT(n) : (floatN)0.0f);
      values[step] = sample_value(fetch_along(volume, view, &ray, t), view), counts[step] = n;
      at += n;
    }
    intN place = i;
    UNROLL_LANES for (int step = 0; step < MARCH_STEPS; ++step) {
      const intN active = MASK(place <= last), n = counts[step];
      const floatN t = TO_FLOAT(place), length = TO_FLOAT(n);
      taken -= AS_UINT(active);
      const floatN before = acc.a;
      const floatN value = values[step];
      int visible;
#if MIDPOINTS
      visible = may_be_visible(value, value, active, view);
      if (visible) composite_steps(&acc, value, n, 0, active, table, view);
#else
      const intN closes = active & MASK(run > 0);
      const floatN b = TO_FLOAT(before1);
      floatN front = value1, back = value;
      shift_uneven_ends(value2, &front, &back, TO_FLOAT(max(before2, (intN)1)), b, closes & MASK(run > 1));
      value2 = select(value2, value1, active), value1 = select(value1, value, active);
      before2 = select(before2, before1, active);
      visible = may_be_visible(lane_min(front, back), lane_max(front, back), closes, view);
      if (visible) composite_segment(&acc, front, back, b, closes, table, view);
      run = select(run, min(run + 1, (intN)2), active);
#endif
      if (visible) {
#if WITH_DEPTH
        const intN passes = passes_half(before, acc.a);
        if (any_lane(passes)) {
#if MIDPOINTS
          note_half(&half_, passes, before, t, length, value, value);
#else
          note_half(&half_, passes, before, t - b, b, front, back);
#endif
        }
#endif
        last = select(last, (intN)DONE, MASK(acc.a >= view->stop_opacity));
      }
      before1 = select(before1, n, active);
      place += n;
    }
    i = place;
  }

  /* The last piece of each ray, shorter than a step. */
  intN active = MASK(last != DONE) & MASK(rest > 0.0f);
#if SKIP_EMPTY
  /* Rays shorter than a step have not looked yet. */
  const intN looks = active & MASK(whole < 1.0f);
  if (any_lane(looks))
    active &= ~looks | MASK(next_visible(distances, view, whole, span_to, looks, &ray, counted) < ray.length);
#endif
  if (any_lane(active)) {
    const floatN t = MIDPOINTS ? whole + 0.5f * rest : ray.length;
    const FetchedSample sample = fetch_along(volume, view, &ray, t);
    const floatN before = acc.a, value = sample_value(sample, view);
    floatN front = value, back = value;
    taken -= AS_UINT(active);
#if MIDPOINTS
    if (may_be_visible(value, value, active, view)) composite_value(&acc, value, rest, active, table, view);
#else
    front = value1;
    shift_uneven_ends(value2, &front, &back, TO_FLOAT(max(before2, (intN)1)), rest, active & MASK(run > 1));
    if (may_be_visible(lane_min(front, back), lane_max(front, back), active, view))
      composite_segment(&acc, front, back, rest, active, table, view);
#endif
#if WITH_DEPTH
    const intN passes = passes_half(before, acc.a);
    note_half(&half_, passes, before, whole, rest, front, back);
#endif
  }
  gathered_store(&acc, rgba);
#if WITH_DEPTH && MIDPOINTS
  note_sampled_ends(&half_, volume, table, view, &ray, &taken, counted);
#endif
#if WITH_DEPTH
  STORE_LANES((ray.entry_depth + half_place(&half_, 1.0f, table, view) * view->step) * view->edge_length, depth);
#endif
  STORE_LANES(taken, samples);
}

#endif
