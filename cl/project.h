/* A packet of LANES rays under another compositing than "over": one value of each ray is picked, and the transfer
 * function's colour and opacity there (of one opacity unit) are the picture. Switch COMPOSITING:
 *
 *   MAXIMUM, MINIMUM    the largest, smallest of the values
 *   AVERAGE             their mean by length
 *   ATTENUATED_MAXIMUM  the largest of (value normalised to the volume's range, at least 0) times exp(-attenuation
 *                       times the integral of that before it); its opacity is attenuated as much
 *
 * A ray's kept stretches (clip.h) are cut into segments one step long, the last one shorter, and the value in the
 * middle of each counts. Values that are not finite do not count, nor does what masks remove (fields.h); a ray without
 * a value shows nothing. The first one of equal values counts. Values are clamped to the bounds of all samples
 * (lowest_sample, highest_sample): rounding alone could take them beyond.
 *
 * Leaping (SKIP_EMPTY). `factors` holds, for each cell of empty space, a bound of the score of every sample in it, and
 * then the same for cells 4 and 16 times as long: a ray leaps out of the largest cell of these that cannot change its
 * result, and ends where no cell ahead can. Scores do not count either that are transparent with all below them
 * (hidden_score). Under attenuation, what is leapt over would be missing from the integral: only cells where all of it
 * is 0 are leapt over, and rays end early. Averages need every sample. The picture is the same, bit for bit.
 */
#ifndef PROJECT_H
#define PROJECT_H

#include "background.h"
#include "classify.h"
#include "clip.h"
#include "composite.h"
#include "emission.h"
#include "features.h"
#include "march.h"
#include "owned_box.h"
#include "packet_spans.h"
#include "rays.h"
#include "scene.h"
#include "scene_value.h"
#include "skip_empty.h"
#if FIELDS
#include "fields.h"
#endif

#define BOUND_LEVELS 3
#define BOUND_SHIFT 2 /* from one level to the next, log2 */
#define NO_SCORE (-3e38f)

#define VALUES_IN_RUNS (BLOCKS && !NOISE)
#define SCORE_LEAPS (SKIP_EMPTY && COMPOSITING != COMPOSITING_AVERAGE)

#if SCORE_LEAPS

/* For each ray at parameter t (in steps): t itself where a sample in its cell can score more than `needed`, else where
 * it first enters a cell where one can (a little before), or infinity if it never does. Compare next_visible()
 * in skip_empty.h. */
INLINE floatN next_above(const Scene *scene, const Rays *ray, floatN t, floatN needed, intN active)
{
  __constant const View *view = scene->view;
  __global const float *bounds = scene->factors;
  const intN one = 1, zero = 0;
  const intN right = select(zero, one, MASK(ray->dx > 0.0f)), down = select(zero, one, MASK(ray->dy > 0.0f));
  const intN away = select(zero, one, MASK(ray->dz > 0.0f));
  const floatN fastest = lane_max(lane_max(fabs(ray->dx), fabs(ray->dy)), fabs(ray->dz));
  const floatN least_margin = FACE_MARGIN(view) / lane_max(fastest, (floatN)1e-12f);
  const floatN x0 = AMONG_CELLS(ray->x0), y0 = AMONG_CELLS(ray->y0), z0 = AMONG_CELLS(ray->z0);
  floatN entered = t;
  for (;;) {
    const intN x = TO_INT(lane_clamp(x0 + t * ray->dx, (floatN)0.0f, (floatN)view->upper.x));
    const intN y = TO_INT(lane_clamp(y0 + t * ray->dy, (floatN)0.0f, (floatN)view->upper.y));
    const intN z = TO_INT(lane_clamp(z0 + t * ray->dz, (floatN)0.0f, (floatN)view->upper.z));
    int shift = view->cell_shift, nx = view->cells.x, ny = view->cells.y, nz = view->cells.z, first = 0;
    intN leaps = active, across = shift;
    _Pragma("unroll 1") for (int level = 0; level < BOUND_LEVELS; ++level) {
      const intN cx = min(x >> shift, (intN)(nx - 1)), cy = min(y >> shift, (intN)(ny - 1));
      const intN cz = min(z >> shift, (intN)(nz - 1));
      const floatN bound = AS_FLOAT(gather4(bounds + first, (cz * ny + cy) * nx + cx));
      leaps &= MASK(bound <= needed);
      if (!any_lane(leaps)) break;
      if (level == 0) active = leaps;
      across = select(across, (intN)shift, leaps);
      first += nx * ny * nz, shift += BOUND_SHIFT;
      nx = (nx + (1 << BOUND_SHIFT) - 1) >> BOUND_SHIFT, ny = (ny + (1 << BOUND_SHIFT) - 1) >> BOUND_SHIFT;
      nz = (nz + (1 << BOUND_SHIFT) - 1) >> BOUND_SHIFT;
    }
    if (shift == view->cell_shift) return entered; /* no lane leaps */
    const intN fx = ((x >> across) + right) << across, fy = ((y >> across) + down) << across;
    const intN fz = ((z >> across) + away) << across;
    const floatN leave_x = (TO_FLOAT(fx) - x0) * ray->rx + ray->px;
    const floatN leave_y = (TO_FLOAT(fy) - y0) * ray->ry + ray->py;
    const floatN leave = lane_min(lane_min(leave_x, leave_y), (TO_FLOAT(fz) - z0) * ray->rz + ray->pz);
    const floatN face = lane_max(leave, t), margin = least_margin + SHARE_OF_T * face;
    entered = select(entered, face - margin, active);
    t = select(t, face + margin, active);
    entered = select(entered, (floatN)INFINITY, active & MASK(t >= ray->length));
    active &= MASK(t < ray->length);
  }
}

#endif

/* The middle of segment i of a ray. */
INLINE floatN middle_of(const Rays *ray, intN i)
{
  const floatN t = TO_FLOAT(i);
  return 0.5f * (t + lane_min(t + 1.0f, ray->length));
}

PER_PACKET void render_packet(const Scene *scene, intN px, intN py, Span span, float *rgba, float *depth, uint *samples,
                          Tally *counted)
{
  __global const float *table = scene->table;
  __constant const View *view = scene->view;
  __constant const Effects *effects = scene->effects;
  const float h = view->step, lowest = effects->lowest_sample, highest = effects->highest_sample;
  const Rays whole_ray = make_rays(view, TO_FLOAT(px), TO_FLOAT(py));
  const intN on_picture = MASK(px < view->image.x) & MASK(py < view->image.y);
  intN alive = MASK(whole_ray.length >= 0.0f) & on_picture;
  uintN taken = 0;
  Rays ray = whole_ray;
  floatN next_from = 0.0f; /* where the next stretch may begin, in steps along whole_ray */
  intN i = 0, last = DONE;
  floatN best = NO_SCORE, picked = lowest, picked_at = INFINITY; /* its score, value, and place in edges from the eye */
#if COMPOSITING == COMPOSITING_AVERAGE
  floatN sum = 0.0f, length_sum = 0.0f;
#elif COMPOSITING == COMPOSITING_ATTENUATED_MAXIMUM
  floatN attenuation = 1.0f, passed = 0.0f, opacity_share = 1.0f;
#if SCORE_LEAPS
  floatN looked_to = 0.0f; /* before that no sample need be asked whether the ray may end, in steps */
#endif
#endif

  for (;;) {
    /* Rays at the end of a stretch go on to their next. */
    const intN stretches = alive & MASK(i > last);
    if (any_lane(stretches)) {
#if CLIP
      const Stretch next = next_stretch(scene, &whole_ray, next_from, h);
      const intN found = stretches & MASK(next.enter < next.leave);
      const Rays along = ray_along(&whole_ray, next.enter, next.leave, found, h);
      next_from = select(next_from, next.leave, found);
#else
      const intN found = stretches & MASK(next_from < whole_ray.length);
      const Rays along = whole_ray;
      next_from = select(next_from, whole_ray.length, stretches);
#endif
      ray = select_rays(ray, along, stretches);
      i = select(i, (intN)0, stretches);
      const floatN cells = ceil(lane_max(ray.length, (floatN)0.0f));
      last = select(last, TO_INT(cells) - 1, stretches);
      alive &= found | ~stretches;
      last = select(last, (intN)DONE, ~alive);
#if SCORE_LEAPS && COMPOSITING == COMPOSITING_ATTENUATED_MAXIMUM
      looked_to = select(looked_to, (floatN)0.0f, stretches);
#endif
    }
    if (!any_lane(alive)) break;
#if SCORE_LEAPS
    {
      const intN going = alive & MASK(i <= last);
      const floatN t = middle_of(&ray, i);
      floatN needed = lane_max(best, (floatN)effects->hidden_score);
#if COMPOSITING == COMPOSITING_ATTENUATED_MAXIMUM
      /* What lies ahead counts for no more than here: a ray ends where nothing ahead could win. Of its last stretch
       * alone, since what is left out would be missing from the integral in the next. */
      const intN looks = going & MASK(t >= looked_to) & MASK(next_from >= whole_ray.length);
      if (any_lane(looks)) {
        looked_to = select(looked_to, next_above(scene, &ray, t, best / lane_max(attenuation, (floatN)1e-30f), looks),
                           looks);
        last = select(last, (intN)DONE, looks & MASK(looked_to >= ray.length));
      }
      needed = select((floatN)NO_SCORE, (floatN)0.0f, MASK(best >= 0.0f));
#endif
      const intN leaping = going & MASK(i <= last);
      const floatN visible_at = next_above(scene, &ray, t, needed, leaping);
      const intN next = TO_INT(ceil(lane_clamp(visible_at, (floatN)0.0f, TO_FLOAT(max(last, (intN)0)) + 1.0f) - 0.5f));
      i = select(i, next, leaping & MASK(next > i));
      i = select(i, last + 1, leaping & MASK(visible_at >= ray.length));
    }
#endif
#if VALUES_IN_RUNS
    floatN values[MARCH_STEPS];
    values_of_segments(scene, &ray, i, last, 0, alive & MASK(i <= last), values);
#endif
    _Pragma("unroll 1") for (int step = 0; step < MARCH_STEPS; ++step) {
      const intN active = alive & MASK(i <= last);
      const floatN t = select((floatN)0.0f, middle_of(&ray, i), active);
#if VALUES_IN_RUNS
      const floatN value = values[step];
#else
      const floatN value = scene_value(scene, ray.x0 + t * ray.dx, ray.y0 + t * ray.dy, ray.z0 + t * ray.dz);
#endif
      taken -= AS_UINT(active);
      floatN kept = 1.0f;
#if FIELDS & FIELD_MASK
      const floatN t0 = TO_FLOAT(i);
      kept = kept_by_masks(scene, &ray, t0, lane_min(t0 + 1.0f, ray.length), active, counted);
#endif
#if MAY_BE_NAN
      intN counts = active & finite_lanes(value);
      const floatN v = lane_clamp(select((floatN)lowest, value, counts), (floatN)lowest, (floatN)highest);
#else
      intN counts = active;
      const floatN v = lane_clamp(value, (floatN)lowest, (floatN)highest);
#endif
      counts &= MASK(kept > 0.0f) & owns_front(view, &ray, TO_FLOAT(i));
#if COMPOSITING == COMPOSITING_AVERAGE
      const floatN length = kept * select((floatN)0.0f, lane_min(ray.length - TO_FLOAT(i), (floatN)1.0f), counts);
      sum += length * (v - lowest), length_sum += length;
#else
#if COMPOSITING == COMPOSITING_ATTENUATED_MAXIMUM
      const floatN share = lane_max((v - effects->lowest_value) * effects->values_per_range, (floatN)0.0f);
      const floatN length = kept * select((floatN)0.0f, lane_min(ray.length - TO_FLOAT(i), (floatN)1.0f), counts);
      const floatN score = share * attenuation;
#elif COMPOSITING == COMPOSITING_MINIMUM
      const floatN score = -v;
#else
      const floatN score = v;
#endif
      const intN better = counts & MASK(score > best);
      best = select(best, score, better), picked = select(picked, v, better);
#if WITH_DEPTH
      picked_at = select(picked_at, ray.entry_depth + t * h, better);
#endif
#if COMPOSITING == COMPOSITING_ATTENUATED_MAXIMUM
      opacity_share = select(opacity_share, attenuation, better);
      passed += share * length;
      attenuation = exp(-effects->attenuation * passed);
#endif
#endif
      i -= active;
    }
  }
#if COMPOSITING == COMPOSITING_AVERAGE
  const intN any_value = MASK(length_sum > 0.0f);
  picked = lowest + sum / select((floatN)1.0f, length_sum, any_value);
#else
  const intN any_value = MASK(best > NO_SCORE);
#endif
  SegmentColor shown = color_of_value(picked, (floatN)1.0f, scene_pieces(table, (intN)0, view));
  floatN weight = 1.0f;
#if COMPOSITING == COMPOSITING_ATTENUATED_MAXIMUM
  weight = opacity_share;
#endif
  weight = select((floatN)0.0f, weight, any_value);
#if WITH_DEPTH
  picked_at = select((floatN)INFINITY, picked_at, MASK(weight * shown.a > 0.0f));
#endif
  Gathered acc = {weight * shown.r, weight * shown.g, weight * shown.b, weight * shown.a};
#if ENVIRONMENT_VISIBLE
  const Vectors forward = scaled3(direction_to_local(effects, whole_ray.dx, whole_ray.dy, whole_ray.dz), 1.0f / h);
  show_environment(scene, forward, on_picture, &acc);
#endif
  gathered_store(&acc, rgba);
  floatN told = picked_at * view->edge_length;
#if OWNED_BOX && WITH_DEPTH
  /* Of several boxes the one with the best score shows: scores are requested (0), and then depths (1). */
  const floatN asked = LOAD_LANES(depth);
  told = select(select(told, best, MASK(asked == 0.0f)), (floatN)INFINITY, MASK(asked < 0.0f));
#endif
  STORE_LANES(told, depth);
  STORE_LANES(taken, samples);
}

#endif
