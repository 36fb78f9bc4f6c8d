/* A packet of rays through a volume of blocks (Ljung 2006, section 3): as in march_plain.h, but a segment is as many
 * steps long as step_blocks.h says, and composited at once.
 *
 *   preintegrated  values at the ends of segments
 *   post           values in the middle of each
 */
#ifndef MARCH_BLOCKS_H
#define MARCH_BLOCKS_H

#include "block_runs.h"
#include "classify.h"
#include "coherence.h"
#include "features.h"
#include "half_opacity.h"
#include "packet_spans.h"
#include "rays.h"
#include "scene.h"
#include "skip_empty.h"
#include "step_blocks.h"

#if CLASSIFICATION == CLASSIFICATION_PRE
#error "blocks are classified after interpolation"
#endif

INLINE void place_on_ray(const Rays *ray, const BlockVolume *v, floatN t, floatN *px, floatN *py, floatN *pz)
{
  const float4 upper = v->view->upper;
  *px = lane_clamp(ray->x0 + t * ray->dx, (floatN)0.5f, (floatN)(upper.x + 0.5f));
  *py = lane_clamp(ray->y0 + t * ray->dy, (floatN)0.5f, (floatN)(upper.y + 0.5f));
  *pz = lane_clamp(ray->z0 + t * ray->dz, (floatN)0.5f, (floatN)(upper.z + 0.5f));
}

/* Several steps of a packet: where samples are taken does not depend on what they are. So places come first, then all
 * values (block_runs.h), then classification in order. A ray that turns out to be opaque on the way has taken a few
 * samples in vain. */
typedef struct {
  float t[QUEUED_STEPS][LANES];    /* of the sample (preintegrated), or of the end of its segment (post) */
  int active[QUEUED_STEPS][LANES];
  BlockRun run;
} March;

PER_PACKET void render_packet(const Scene *scene, intN px, intN py, Span span, float *rgba, float *depth, uint *samples,
                          Tally *counted FIRST_PARAMETER)
{
  __global const uchar *distances = scene->distances;
  __global const float *table = scene->table;
  __constant const View *view = scene->view;
  const BlockVolume *v = &scene->blocks;
  Rays ray = make_rays(view, TO_FLOAT(px), TO_FLOAT(py));
  ray.x0 += 0.5f, ray.y0 += 0.5f, ray.z0 += 0.5f;
  intN active = MASK(ray.length > 0.0f) & MASK(px < view->image.x) & MASK(py < view->image.y);
  BEGIN_FIRST(active);
  const floatN zero = 0.0f, one = 1.0f;
  const floatN end = select(zero, ray.length, active);
  uintN taken = 0;
  Gathered acc;
  gathered_clear(&acc);
  HalfOpacity half_ = no_half(); /* in steps */
  /* One step before what may be visible: leaps begin where they would without a span. */
  floatN span_from, span_to;
  span_along(view, span, &ray, TO_FLOAT(px), TO_FLOAT(py), view->step, &span_from, &span_to);
  const floatN start = floor(lane_clamp(span_from - 1.0f, zero, lane_max(ray.length - 1.0f, zero)));
#if MIDPOINTS
  floatN t = start, t1 = start; /* where the next segment begins, to be sampled and to be composited */
#else
  floatN value1 = 0.0f, value2 = 0.0f; /* the last sample and the one before it, and where they are */
  floatN t1 = 0.0f, t2 = 0.0f;
  intN alone = ~(intN)0, second = 0;   /* the run of samples begins: no sample before, or only one */
  floatN t = start;                    /* the next sample */
#endif

  while (any_lane(active)) {
#if SKIP_EMPTY
    /* A segment that is open depends on its front and the sample before that one. A leap opens a new one. */
#if MIDPOINTS
    const floatN from = t;
#else
    const floatN from = select(select(t2, t1, second), t, alone);
#endif
    const floatN visible_at = next_visible(distances, view, from, lane_min(span_to, ray.length), active, &ray, counted);
    active &= MASK(visible_at < end);
    const floatN next = floor(select(t, visible_at, active)) - (MIDPOINTS ? 0.0f : 1.0f);
    const intN leaps = active & MASK(next > t);
    t = select(t, next, leaps);
#if MIDPOINTS
    t1 = t;
#else
    alone |= leaps;
#endif
    if (!any_lane(active)) break;
#endif
    March m;
    run_begin(&m.run);
    Record here = record_at(v, (floatN)0.5f, (floatN)0.5f, (floatN)0.5f);
    int kind = alike(v, &here);
    intN walks = active;
    floatN next_t = t;
    _Pragma("unroll 1") for (int step = 0; step < QUEUED_STEPS; ++step) {
      floatN x, y, z;
      place_on_ray(&ray, v, next_t, &x, &y, &z);
#if MIDPOINTS
#if STEPPING == STEPPING_FULL
      const floatN far = lane_min(next_t + 1.0f, end);
#else
      move_record(v, &here, &kind, x, y, z);
      const floatN far = lane_min(next_t + steps_at_once(v, &ray, &here, next_t), end);
#endif
      place_on_ray(&ray, v, next_t + 0.5f * lane_max(far - next_t, zero), &x, &y, &z);
      move_record(v, &here, &kind, x, y, z);
      STORE_LANES(far, m.t[step]);
#else
      move_record(v, &here, &kind, x, y, z);
      const floatN far = lane_min(next_t + steps_at_once(v, &ray, &here, next_t), end);
      STORE_LANES(next_t, m.t[step]);
#endif
      STORE_LANES(walks, m.active[step]);
      run_place(v, &m.run, step, &here, kind, x, y, z, walks, counted);
      taken -= AS_UINT(walks);
      walks &= MASK(next_t < end);
      next_t = select(next_t, far, walks);
#if MIDPOINTS
      walks &= MASK(far < end);
#endif
    }
    run_end(v, &m.run, QUEUED_STEPS, counted);
    t = select(t, next_t, active);
    _Pragma("unroll 1") for (int step = 0; step < QUEUED_STEPS; ++step) {
      active &= LOAD_LANES(m.active[step]);
      if (!any_lane(active)) break;
      const floatN value = run_value(&m.run, step), at_t = LOAD_LANES(m.t[step]);
#if MIDPOINTS
      if (may_be_visible(value, value, active, view)) {
        const floatN before = acc.a;
        composite_value(&acc, value, lane_max(at_t - t1, zero), active, table, view);
        NOTE_FIRST(before, acc.a, t1);
        pass_opacity(&acc, before, &half_, t1, at_t, value, value);
      }
      t1 = select(t1, at_t, active);
#else
      const intN closes = active & ~alone; /* lanes with a segment that ends here */
      const floatN long_ = select(one, at_t - t1, closes);
      floatN front = value1, back = value;
#if STEPPING == STEPPING_FULL
      shift_ends(value2, &front, &back, long_, closes & ~second);
#else
      shift_uneven_ends(value2, &front, &back, select(one, t1 - t2, closes & ~second), long_, closes & ~second);
#endif
#if COHERENT
      /* As in march_plain.h: the first segment after a start within the ray shows nothing. */
      const intN counts = closes & (~second | MASK(t1 <= zero));
#else
      const intN counts = closes;
#endif
      if (may_be_visible(lane_min(front, back), lane_max(front, back), counts, view)) {
        const floatN before = acc.a;
        composite_segment(&acc, front, back, long_, counts, table, view);
        NOTE_FIRST(before, acc.a, t1);
        pass_opacity(&acc, before, &half_, t1, at_t, front, back);
      }
      value2 = select(value2, value1, active), t2 = select(t2, t1, active);
      value1 = select(value1, value, active), t1 = select(t1, at_t, active);
      second = select(second, alone, active), alone &= ~active;
#endif
      active &= MASK(at_t < end) & MASK(acc.a < view->stop_opacity);
    }
  }
#if COHERENT
  *first = ray.entry_depth + *first * view->step; /* it was in steps */
#endif
  gathered_store(&acc, rgba);
#if WITH_DEPTH
  STORE_LANES((ray.entry_depth + half_place(&half_, 1.0f, table, view) * view->step) * view->edge_length, depth);
#endif
  STORE_LANES(taken, samples);
}

#endif
