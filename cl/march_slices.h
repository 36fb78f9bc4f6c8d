/* A packet of LANES rays through slices of the volume: what textured polygons drawn one over the other show, by the
 * classification and compositing of the other marches. Slices lie where the volume and the eye put them, not where a
 * ray enters, and what is in front of a ray's first slice and behind its last does not count.
 *
 *   along-axis   planes perpendicular to an axis of the voxels, which a ray meets at d / |cos|. Where they are planes of
 *                voxels, interpolation is bilinear: the third weight is 0
 *   along-view   planes parallel to the picture: d / cos
 *   shells       spheres around the eye, d apart on every ray; planes for an orthographic one
 * (Engel, Ertl, Interactive high-quality volume rendering with flexible consumer graphics hardware, 2002, section 4;
 * shells: LaMar, Hamann, Joy, Multiresolution techniques for interactive texture-based volume visualization, 1999.)
 *
 * CLASSIFICATION pre and post: a slice stands for its thickness; slices along the view lie in the middle of what they
 * stand for. preintegrated: two slices bound a slab (Engel, Kraus, Ertl, High-quality pre-integrated volume rendering,
 * 2001). OPACITY_CORRECTION: the opacity is that of the ray's way from slice to slice, else that of `thickness`.
 * ACCUMULATE: a pixel is rounded to half floats, or to 8 bits, after each slice, as in a frame buffer.
 * SLAB_SAMPLES: for measurements; 2: both ends of a slab are sampled for it, as textures are, which know nothing of the
 * slab before. It changes no bit.
 */
#ifndef MARCH_SLICES_H
#define MARCH_SLICES_H

#include "classify.h"
#include "features.h"
#include "half_opacity.h"
#include "march.h"
#include "packet_spans.h"
#include "rays.h"
#include "scene.h"
#include "slices.h"

#ifndef SLAB_SAMPLES
#define SLAB_SAMPLES 1
#endif

/* Of a slice's spacing: a ray that enters through the face that a slice lies in meets that slice. */
#define NEARLY 1e-4f

/* The slices that a packet's rays meet. The i-th of a ray, counted from its entry, is at base + i gap. */
typedef struct {
  floatN base, gap; /* steps from the entry */
  floatN nearest;   /* number of the first one; */
  floatN forward;   /* 1 or -1: whether numbers go up along the ray */
  intN count;
} RaySlices;

#if ACCUMULATE == ACCUMULATE_HALF
/* To the nearest half float: 11 bits (Dekker 1971), and 2^-24 where halves are denormal. */
INLINE floatN rounded_channel(floatN x)
{
  const floatN split = x * 8193.0f, rounded = split - (split - x);
  return select(rounded, rint(x * 16777216.0f) * (1.0f / 16777216.0f), MASK(x < 6.103515625e-5f));
}
#elif ACCUMULATE == ACCUMULATE_UINT8
INLINE floatN rounded_channel(floatN x) { return rint(lane_min(x, (floatN)1.0f) * 255.0f) * (1.0f / 255.0f); }
#endif

INLINE void round_pixel(Gathered *acc)
{
#if ACCUMULATE != ACCUMULATE_FLOAT32
  acc->r = rounded_channel(acc->r), acc->g = rounded_channel(acc->g);
  acc->b = rounded_channel(acc->b), acc->a = rounded_channel(acc->a);
#endif
}

INLINE floatN along_axis(int axis, floatN x, floatN y, floatN z) { return axis == 0 ? x : axis == 1 ? y : z; }

INLINE RaySlices slices_of(const Rays *ray, __constant const Slices *slices, __constant const View *view, floatN column,
                           floatN row)
{
  RaySlices s;
#if SLICES == SLICES_ALONG_AXIS
  const floatN at = along_axis(slices->axis, ray->x0, ray->y0, ray->z0);
  const floatN moves = along_axis(slices->axis, ray->dx, ray->dy, ray->dz);
  const intN crosses = MASK(fabs(moves) > PARALLEL);
  const floatN speed = select((floatN)1.0f, moves, crosses) / slices->spacing; /* slices per step */
  const floatN enter = (at - slices->first) / slices->spacing, leave = enter + ray->length * speed;
  const intN up = MASK(speed > 0.0f);
  const floatN most = (float)(slices->count - 1);
  const floatN low = lane_max(ceil(lane_min(enter, leave) - NEARLY), (floatN)0.0f);
  const floatN high = lane_min(floor(lane_max(enter, leave) + NEARLY), most);
  s.forward = select((floatN)-1.0f, (floatN)1.0f, up);
  s.nearest = select(high, low, up);
  s.gap = 1.0f / fabs(speed);
  s.base = (s.nearest - enter) / speed;
  s.count = select((intN)0, TO_INT(lane_max(high - low, (floatN)-1.0f)) + 1, crosses);
#else
  const floatN a = (column - view->centre.x) * view->tangent.x, b = (row - view->centre.y) * view->tangent.y;
  const floatN squares = a * a + b * b, longer = sqrt(1.0f + squares);
  const floatN from_plane = ray->entry_depth - view->plane_distance * longer; /* edges */
#if SLICES == SLICES_ALONG_VIEW
  const floatN depth = from_plane / longer / view->step, per_step = 1.0f / longer;
#else
  /* Distance from the eye beyond that of the reference plane: no difference of large numbers. */
  const floatN depth = (from_plane + view->plane_distance * squares / (1.0f + longer)) / view->step, per_step = 1.0f;
#endif
  const floatN enter = (depth - slices->first) / slices->spacing;
  const floatN leave = enter + ray->length * per_step / slices->spacing;
  s.forward = 1.0f;
  s.nearest = ceil(enter - NEARLY);
  s.gap = slices->spacing / per_step;
  s.base = (s.nearest - enter) * s.gap;
  s.count = TO_INT(lane_max(floor(leave + NEARLY) - s.nearest, (floatN)-1.0f)) + 1;
#endif
  return s;
}

/* What is fetched where the rays meet their slices number i, `t` steps from the entry. */
INLINE FetchedSample fetch_slice(__global const uchar *volume, __constant const Slices *slices,
                                 __constant const View *view, const Rays *ray, const RaySlices *met, floatN i, floatN t)
{
  floatN x = ray->x0 + t * ray->dx, y = ray->y0 + t * ray->dy, z = ray->z0 + t * ray->dz;
#if SLICES == SLICES_ALONG_AXIS
  /* Exactly in the slice: planes of voxels are not interpolated between. */
  const floatN place = slices->first + (met->nearest + i * met->forward) * slices->spacing;
  if (slices->axis == 0) x = place;
  else if (slices->axis == 1) y = place;
  else z = place;
#endif
  return fetch_sample(volume, view, x, y, z);
}

PER_PACKET void render_packet(const Scene *scene, intN px, intN py, Span span, float *rgba, float *depth, uint *samples,
                          Tally *counted)
{
  __constant const View *view = scene->view;
  const Rays ray = make_rays(view, TO_FLOAT(px), TO_FLOAT(py));
  const intN hits = MASK(ray.length >= 0.0f) & MASK(px < view->image.x) & MASK(py < view->image.y);
  const RaySlices met = slices_of(&ray, scene->slices, view, TO_FLOAT(px), TO_FLOAT(py));
#if OPACITY_CORRECTION
  const floatN thickness = met.gap;
#else
  const floatN thickness = scene->slices->thickness;
#endif
  intN last = select((intN)DONE, met.count - 1, hits);
  uintN taken = 0;
  floatN front = 0.0f; /* the value at the slice before */
  Gathered acc;
  gathered_clear(&acc);
  HalfOpacity half_ = no_half(); /* in steps */
  for (intN i = 0; any_lane(MASK(i <= last)); ++i) {
    intN active = MASK(i <= last);
    taken -= AS_UINT(active);
    const floatN number = TO_FLOAT(i), before = acc.a;
    const floatN t = lane_clamp(met.base + number * met.gap, (floatN)0.0f, lane_max(ray.length, (floatN)0.0f));
    const FetchedSample sample = fetch_slice(scene->volume, scene->slices, view, &ray, &met, number, t);
#if CLASSIFICATION == CLASSIFICATION_PRE
    const Emission classified = classified_emission(sample, view, scene->table);
    composite_classified(&acc, classified, thickness, active);
    const floatN value = 0.0f, from = t - 0.5f * met.gap;
    front = value;
#else
    const floatN value = sample_value(sample, view);
#if CLASSIFICATION == CLASSIFICATION_POST
    const floatN from = t - 0.5f * met.gap;
    front = value;
    if (may_be_visible(value, value, active, view))
      composite_value(&acc, value, thickness, active, scene->table, view);
#else
    const floatN from = t - met.gap;
    active &= MASK(i > 0);
#if SLAB_SAMPLES == 2
    if (any_lane(active)) {
      const floatN at = met.base + (number - 1.0f) * met.gap;
      const floatN t0 = lane_clamp(at, (floatN)0.0f, lane_max(ray.length, (floatN)0.0f));
      front = sample_value(fetch_slice(scene->volume, scene->slices, view, &ray, &met, number - 1.0f, t0), view);
      taken -= AS_UINT(active);
    }
#endif
    if (may_be_visible(lane_min(front, value), lane_max(front, value), active, view))
      composite_segment(&acc, front, value, thickness, active, scene->table, view);
#endif
#endif
    round_pixel(&acc);
#if WITH_DEPTH
    const intN passes = passes_half(before, acc.a);
    note_half(&half_, passes, before, from, thickness, front, value);
#if CLASSIFICATION == CLASSIFICATION_PRE
    note_whole(&half_, passes, thickness * classified.d, 0.0f);
#endif
#endif
    front = value;
    last = select(last, (intN)DONE, MASK(acc.a >= view->stop_opacity));
  }
  gathered_store(&acc, rgba);
#if WITH_DEPTH
  STORE_LANES((ray.entry_depth + half_place(&half_, 1.0f, scene->table, view) * view->step) * view->edge_length, depth);
#endif
  STORE_LANES(taken, samples);
}

#endif
