/* A packet of LANES rays from front to back: emission and absorption along each.
 *
 * All rays of a packet march together, each at its own depth: they leap over empty space (skip_empty.h), then take
 * MARCH_STEPS samples, and so on until every ray has left the volume or is opaque. Lanes that have nothing to do are
 * masked; what a lane computes never depends on its neighbours, so a pixel is the same, bit for bit, whatever packet
 * it is in.
 *
 * Sampling along a ray of length L (in steps of length h): n = floor(L) whole segments and one of length L - n.
 *   preintegrated   values at 0, 1, ..., n and L; a segment's colour depends on the values at its ends
 *   pre, post       values at the middle of each segment
 */
#ifndef MARCH_PLAIN_H
#define MARCH_PLAIN_H

#include "along_rays.h"
#include "classify.h"
#include "coherence.h"
#include "features.h"
#include "half_opacity.h"
#include "march.h"
#include "owned_box.h"
#include "packet_spans.h"
#include "rays.h"
#include "scene.h"
#include "segment_queue.h"
#include "skip_empty.h"
#include "skip_steps.h"

PER_PACKET void render_packet(const Scene *scene, intN px, intN py, Span span, float *rgba, float *depth, uint *samples,
                          Tally *counted FIRST_PARAMETER)
{
  __global const uchar *volume = scene->volume, *distances = scene->distances;
  __global const float *table = scene->table;
  __constant const View *view = scene->view;
  const Rays ray = make_rays(view, TO_FLOAT(px), TO_FLOAT(py));
  const floatN whole = floor(ray.length), rest = ray.length - whole;
  const intN hits = MASK(ray.length >= 0.0f) & MASK(px < view->image.x) & MASK(py < view->image.y);
  BEGIN_FIRST(hits);
  const floatN offset = MIDPOINTS ? 0.5f : 0.0f;
  intN last = select((intN)DONE, TO_INT(whole) - MIDPOINTS, hits);
  floatN span_from, span_to;
  span_along(view, span, &ray, TO_FLOAT(px), TO_FLOAT(py), view->step, &span_from, &span_to);
  span_to = lane_min(span_to, ray.length);
  /* One step before what may be visible: leaps begin where they would without a span. */
  intN i = TO_INT(lane_clamp(span_from - 1.0f, (floatN)0.0f, TO_FLOAT(max(last, (intN)0))));
  uintN taken = 0;
  Gathered acc;
  gathered_clear(&acc);
  BEGIN_OPACITY(acc, depth);
  HalfOpacity half_ = no_half(); /* in steps */
#if !MIDPOINTS
  floatN value1 = 0.0f, value2 = 0.0f;  /* the last sample and the one before */
  intN start = i;                      /* where the unbroken run of samples began: there is no sample before */
#endif

  while (any_lane(MASK(i <= last))) {
#if SKIP_EMPTY
    /* Of midpoints, the first one inside the visible cell is next. Else two samples before it open a new segment, and
     * one that is open depends on samples i - 2 and i - 1. */
#if MIDPOINTS
    const floatN from = TO_FLOAT(i) + offset;
#else
    const floatN from = TO_FLOAT(max(i - 2, start));
#endif
    const Cells cells = cells_at(distances, view, from, &ray);
    if (any_lane(MASK(i <= last) & (MASK(cells.distance > 0) | MASK(from >= span_to)))) {
      const intN leaps = leap_along(cells, distances, view, from, span_to, &ray, &i, &last, counted);
#if !MIDPOINTS
      start = select(start, i, leaps);
#endif
    }
#endif
    /* Where no ray leaps, the next places depend by branches alone on what the steps before have shown. Processors
     * foresee those, and fetch the next voxels meanwhile. A ray that is done goes on for nothing. */
    const floatN first_t = TO_FLOAT(i) + offset;
    /* First all samples, then what they show: so short a loop has many steps under way at once, and none of them waits
     * for the cache alone. */
#if CLASSIFICATION != CLASSIFICATION_PRE
    floatN values[MARCH_STEPS];
    UNROLL_LANES for (int step = 0; step < MARCH_STEPS; ++step)
      values[step] = sample_value(fetch_along(volume, view, &ray, first_t + (float)step), view);
#endif
#if QUEUED_SEGMENTS
    /* How many of these steps each ray takes, if it does not end before; then which segments can be visible. */
    intN steps = max(min(last + 1 - i, (intN)MARCH_STEPS), (intN)0);
    uint shown[MARCH_STEPS], todo = 0;
    floatN fronts[MARCH_STEPS], backs[MARCH_STEPS];
    const intN opens = start - i, blind = blind_segments(start);
    UNROLL_LANES for (int step = 0; step < MARCH_STEPS; ++step) {
      const intN goes_on = MASK(step < steps);
      const floatN value = values[step];
      const intN closes = goes_on & MASK(step > opens + blind);
      floatN front = value1, back = value;
      shift_ends(value2, &front, &back, 1.0f, closes & MASK(step > opens + 1));
      value2 = select(value2, value1, goes_on), value1 = select(value1, value, goes_on);
      fronts[step] = front, backs[step] = back;
      const intN owned = closes & owns_front(view, &ray, first_t + ((float)step - 1.0f));
      const intN shows = owned & lanes_that_show(lane_min(front, back), lane_max(front, back), view);
      shown[step] = lane_bits(shows);
      todo |= (uint)(shown[step] != 0) << step;
    }
    uint ended = 0;
    while (todo) {
      SegmentQueue queue;
      QueuedColors colors;
      empty_queue(&queue);
      uint queued = 0;
      do {
        const uint next = todo & -todo;
        const int step = 31 - clz(next);
        shown[step] &= ~ended;
        if (queue.count + popcount(shown[step]) > LANES) break;
        append_segments(&queue, fronts[step], backs[step], shown[step]);
        queued |= next, todo ^= next;
      } while (todo);
      colors_of_queue(&queue, table, view, &colors);
      int from = 0;
      do {
        const uint next = queued & -queued;
        const int step = 31 - clz(next);
        const intN active = lanes_of(shown[step] & ~ended);
        const floatN before = acc.a;
        composite_color(&acc, queued_color(&colors, shown[step], from), active);
        NOTE_FIRST(before, acc.a, first_t + ((float)step - 1.0f));
        from += popcount(shown[step]), queued ^= next;
#if WITH_DEPTH
        const intN passes = passes_half(before, acc.a);
        if (any_lane(passes))
          note_half(&half_, passes, before, first_t + ((float)step - 1.0f), 1.0f, fronts[step], backs[step]);
#endif
        const intN ends = active & MASK(acc.a >= view->stop_opacity);
        if (any_lane(ends)) {
          ended |= lane_bits(ends);
          steps = select(steps, (intN)(step + 1), ends), last = select(last, (intN)DONE, ends);
        }
      } while (queued);
    }
    taken += AS_UINT(steps);
    COUNT_LEVELS(&ray, first_t, steps);
#else
    UNROLL_LANES for (int step = 0; step < MARCH_STEPS; ++step) {
      const intN place = i + step, active = MASK(place <= last);
      const floatN t = first_t + (float)step;
      taken -= AS_UINT(active);
      COUNT_LEVELS(&ray, t, active & 1);
      const floatN before = acc.a;
      int visible;
#if CLASSIFICATION == CLASSIFICATION_PREINTEGRATED
      const intN closes = active & MASK(place > start + blind_segments(start)); /* with a segment that ends here */
      const floatN value = values[step];
      floatN front = value1, back = value;
      shift_ends(value2, &front, &back, 1.0f, closes & MASK(place > start + 1));
      value2 = select(value2, value1, active), value1 = select(value1, value, active);
      const intN owned = closes & owns_front(view, &ray, t - 1.0f);
      visible = may_be_visible(lane_min(front, back), lane_max(front, back), owned, view);
      if (visible) composite_segment(&acc, front, back, (floatN)1.0f, owned, table, view);
#elif CLASSIFICATION == CLASSIFICATION_POST
      const floatN value = values[step];
      const intN owned = active & owns_front(view, &ray, t - 0.5f);
      visible = may_be_visible(value, value, owned, view);
      if (visible) composite_steps(&acc, value, (intN)1, 1, owned, table, view);
#else
      visible = 1;
      const Emission classified = classified_emission(fetch_along(volume, view, &ray, t), view, table);
      composite_classified(&acc, classified, (floatN)1.0f, active & owns_front(view, &ray, t - 0.5f));
#endif
      if (visible) {
        NOTE_FIRST(before, acc.a, t - (MIDPOINTS ? 0.5f : 1.0f));
#if WITH_DEPTH
        const intN passes = passes_half(before, acc.a);
        if (any_lane(passes)) {
#if CLASSIFICATION == CLASSIFICATION_PREINTEGRATED
          note_half(&half_, passes, before, t - 1.0f, 1.0f, front, back);
#elif CLASSIFICATION == CLASSIFICATION_POST
          note_half(&half_, passes, before, t - 0.5f, 1.0f, value, value);
#else
          note_half(&half_, passes, before, t - 0.5f, 1.0f, 0.0f, 0.0f);
          note_whole(&half_, passes, classified.d, 0.0f);
#endif
        }
#endif
        last = select(last, (intN)DONE, MASK(acc.a >= view->stop_opacity));
      }
    }
#endif
    i += MARCH_STEPS;
  }

  /* The last piece of each ray, shorter than a step. */
  intN active = MASK(last != DONE) & MASK(rest > 0.0f);
#if SKIP_EMPTY
  /* Rays shorter than a step have not looked yet. Of bricks, where nothing is visible there may be no voxels, either. */
  intN looks = active & MASK(whole < 1.0f);
#if BRICKS
  looks = active;
#endif
  if (any_lane(looks))
    active &= ~looks | MASK(next_visible(distances, view, whole, span_to, looks, &ray, counted) < ray.length);
#endif
  active &= owns_front(view, &ray, whole);
  if (any_lane(active)) {
    const floatN t = MIDPOINTS ? whole + 0.5f * rest : ray.length;
    const FetchedSample sample = fetch_along(volume, view, &ray, t);
    const floatN before = acc.a, value = sample_value(sample, view);
    floatN front = value, back = value;
    taken -= AS_UINT(active);
    COUNT_LEVELS(&ray, t, active & 1);
#if CLASSIFICATION == CLASSIFICATION_PREINTEGRATED
    front = value1;
    active &= MASK(last + 1 > start + blind_segments(start));
    shift_ends(value2, &front, &back, rest, active & MASK(last > start));
    if (may_be_visible(lane_min(front, back), lane_max(front, back), active, view))
      composite_segment(&acc, front, back, rest, active, table, view);
#elif CLASSIFICATION == CLASSIFICATION_POST
    if (may_be_visible(value, value, active, view)) composite_value(&acc, value, rest, active, table, view);
#else
    const Emission classified = classified_emission(sample, view, table);
    composite_classified(&acc, classified, rest, active);
#endif
    NOTE_FIRST(before, acc.a, whole);
#if WITH_DEPTH
    const intN passes = passes_half(before, acc.a);
    note_half(&half_, passes, before, whole, rest, front, back);
#if CLASSIFICATION == CLASSIFICATION_PRE
    note_whole(&half_, passes, rest * classified.d, 0.0f);
#endif
#endif
  }
#if COHERENT
  *first = ray.entry_depth + *first * view->step; /* it was in steps */
#endif
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
