/* Shadows: the share of a light that arrives at a place, through the translucent volume and the iso-surfaces before it.
 *
 * T = exp(-D), D the optical depth along the straight line to the light: as far as the volume's domain or, if it is
 * nearer, a point light. D is integrated as by the eye's rays: over steps of shadow_step edges from the place on, the
 * last one shorter, under the scene's classification and filter, chords shifted by the curvature and so on. A surface
 * adds -log(1 - opacity) where the ray meets it, as the eye's rays do; none is shaded, so that there is no recursion.
 * What is clipped away casts no shadow. The march ends where D is beyond shadow_depth: T is below 1e-3 there.
 *
 * A shadow ray starts in the very surface that it lights: on which side of it the ray runs is decided by the value
 * SURFACE_OFFSET edges along it, not by that at its start, which is the iso-value but for rounding. 0.1 edges stay
 * below all that the voxels resolve, and are 1e-4 edges above the surface where the light grazes it at N.L = 1e-3:
 * farther than the surface itself may be off. A surface lit at a lower angle shows nothing of that light.
 *
 * SHADOWS_RAYS: a march from each sample. Samples whose weight (opacity times what is left of the eye's ray) is not
 * above shadow_bound cast none, and get the light without a shadow: such a sample changes the picture by less than the
 * bound, n of them on a ray by less than n times as much. They do so in very thin fog; a bound of 0 casts for all.
 *
 * SHADOWS_VOLUME: the same march from each point of a grid (light_volume.cl), trilinear between them. Each point has a
 * ray of its own, so that nothing diffuses from slice to slice as in volumes of shadows that are swept slice by slice
 * (Behrens and Ratering 1998; Engel and Ertl 2002, section 5.4, name what that costs: blurred shadows, dark surfaces).
 * What an opaque voxel hides is dark in those light cells alone that touch its shadow. A light cell that a surface
 * passes through has dark corners behind it, by which the surface would darken itself: surfaces look up their light a
 * light cell farther out (beyond_surface). The translucent volume does not: where it turns opaque within less than a
 * light cell, its boundary shows the light cells, and rays are the better method.
 *
 * SHADOWS_HALF_ANGLE: slabs that light and eye go through alike (half_angle.h, slice_light.h).
 */
#ifndef SHADOW_H
#define SHADOW_H

#include "classify.h"
#include "clip.h"
#include "emission.h"
#include "half_opacity.h"
#include "light_cells.h"
#include "opacity.h"
#include "rays.h"
#include "scene.h"
#include "scene_value.h"
#include "skip_empty.h"
#include "tally.h"
#if ISOSURFACES
#include "surface_walk.h"
#endif
#if OPACITY_FACTORS || TRANSFER_LAYERS
#include "opacity_factors.h"
#endif
#if FIELDS
#include "fields.h"
#endif
#if TRANSFER_LAYERS > LAYERS_BY_GRADIENT
#include "joint_layers.h"
#endif
#if SHADOWS == SHADOWS_HALF_ANGLE
#include "slice_light.h"
#endif

#define SURFACE_OFFSET 0.1f
/* Steps between looks at the distance map. Values of blocks are taken in runs. */
#define SHADOW_RUNS (BLOCKS && !NOISE)
#if SHADOW_RUNS
#define SHADOW_STEPS MARCH_STEPS
#else
#define SHADOW_STEPS 8
#endif

#ifndef FADES_WITH_DISTANCE
#define FADES_WITH_DISTANCE 0
#endif
/* Transmittance of rays whose matter counts the less the farther away it is (ambient_occlusion.h); shadow rays have
 * none of it. */
#if FADES_WITH_DISTANCE
typedef struct {
  floatN left, taken;    /* transmittance so far, and what of its fall counts */
  floatN left_near;      /* transmittance within `near` */
  float per_edge, near;  /* 1 / the edges within which matter counts */
} Fading;
#define FADING_PARAMETER , Fading *fading
#define FADING_ARGUMENT , fading

/* `depth` more at `at` edges from the ray's start. */
INLINE void fade_depth(Fading *fading, floatN depth, floatN at, intN active)
{
  const floatN fall = select((floatN)0.0f, fading->left * opacity_of_depth(depth), active);
  fading->taken += fall * lane_max(1.0f - at * fading->per_edge, (floatN)0.0f);
  fading->left -= fall;
  fading->left_near -= select((floatN)0.0f, fall, MASK(at < fading->near));
}
#else
#define FADING_PARAMETER
#define FADING_ARGUMENT
#endif

/* From `place` (lattice) along `direction` (local) to where it leaves the volume, `reach` edges at most; lanes not in
 * `rays` go nowhere. */
INLINE Rays rays_towards(const Scene *scene, Vectors place, Vectors direction, floatN reach, intN rays)
{
  const float4 upper = scene->view->upper;
  const float h = scene->effects->shadow_step;
  const Vectors d = direction_to_lattice(scene->effects, direction);
  Rays r;
  /* A place on a face may be beyond it by a rounding. */
  r.x0 = lane_clamp(place.x, (floatN)0.0f, (floatN)upper.x);
  r.y0 = lane_clamp(place.y, (floatN)0.0f, (floatN)upper.y);
  r.z0 = lane_clamp(place.z, (floatN)0.0f, (floatN)upper.z);
  floatN enter = 0.0f, leave = reach;
  clip_to_slab(r.x0, d.x, upper.x, &enter, &leave);
  clip_to_slab(r.y0, d.y, upper.y, &enter, &leave);
  clip_to_slab(r.z0, d.z, upper.z, &enter, &leave);
  r.dx = d.x * h, r.dy = d.y * h, r.dz = d.z * h;
  r.rx = finite_inverse(r.dx, &r.px), r.ry = finite_inverse(r.dy, &r.py), r.rz = finite_inverse(r.dz, &r.pz);
  r.length = select((floatN)-1.0f, leave * (1.0f / h), rays & MASK(leave > 0.0f));
  r.entry_depth = 0.0f;
  return r;
}

INLINE floatN value_along(const Scene *scene, const Rays *ray, floatN t)
{
  return scene_value(scene, ray->x0 + t * ray->dx, ray->y0 + t * ray->dy, ray->z0 + t * ray->dz);
}

/* Values at the ends of segments; else in their middle. */
#define SHADOW_ENDS (CLASSIFICATION == CLASSIFICATION_PREINTEGRATED)

/* The values of a segment of a shadow ray. */
typedef struct {
  floatN front, back; /* at its ends, shifted by the curvature; or both the one in the middle */
} SegmentValues;

/* Optical depth of a step of the eye's of each of these segments, by the functions that begin `first` floats on. (x,
 * y, z): its middle. */
INLINE floatN depth_of_values(const Scene *scene, SegmentValues v, floatN x, floatN y, floatN z, intN active,
                              intN first)
{
#if CLASSIFICATION == CLASSIFICATION_PRE
  const FetchedSample sample = fetch_sample(scene->volume, scene->view, x, y, z);
  return classified_emission_in(sample, scene->view, first, scene->table).d;
#else
  return depth_between(v.front, v.back, active, first, scene->table, scene->view);
#endif
}

/* Mean optical depth per edge from t0 to t1 of the ray. */
INLINE floatN extinction_along(const Scene *scene, const Rays *ray, floatN t0, floatN t1, SegmentValues v,
                               Vectors direction,
                               intN active, Tally *counted)
{
  __constant const View *view = scene->view;
  const floatN t = 0.5f * (t0 + t1);
  const floatN x = ray->x0 + t * ray->dx, y = ray->y0 + t * ray->dy, z = ray->z0 + t * ray->dz;
  intN shows = active;
#if CLASSIFICATION != CLASSIFICATION_PRE
  if (!may_be_visible(lane_min(v.front, v.back), lane_max(v.front, v.back), active, view)) shows = 0;
#endif
  Emission e = no_emission(); /* of a step of the eye's rays, by which fields count */
#if !TRANSFER_LAYERS
  if (any_lane(shows)) e.d = select((floatN)0.0f, depth_of_values(scene, v, x, y, z, shows, (intN)0), shows);
  shows = MASK(e.d > 0.0f);
#endif
#if FIELDS
  const FieldLook look = look_at_fields(scene, ray, t0, t1, x, y, z, shows, active, counted);
  shows &= MASK(look.kept > 0.0f);
#endif
#if OPACITY_FACTORS || TRANSFER_LAYERS
  if (any_lane(shows)) {
#if OPACITY_FACTORS || TRANSFER_LAYERS == LAYERS_BY_GRADIENT
    count_lanes(&counted[COUNT_GRADIENTS], shows);
    const Vectors gradient = scene_gradient(scene, x, y, z);
#endif
#if TRANSFER_LAYERS == LAYERS_BY_GRADIENT
    const TablePlace layers = layers_around(scene, gradient, view->function_floats);
    const floatN low = depth_of_values(scene, v, x, y, z, shows, layers.low);
    e.d = low + layers.share * (depth_of_values(scene, v, x, y, z, shows, layers.high) - low);
#elif TRANSFER_LAYERS
    const TablePlace layers = joint_layers(scene, x, y, z, shows, view->function_floats, counted);
    floatN row = 0.0f;
    _Pragma("unroll 1") for (int k = 0; k < LAYER_CORNERS; ++k) {
      const floatN layer = depth_of_values(scene, v, x, y, z, shows, layer_corner(layers, k));
      row = k & 1 ? row + layers.share * (layer - row) : layer;
      if (k == 1) e.d = row;
      if (k == 3) e.d += layers.row_share * (row - e.d);
    }
#endif
#if OPACITY_FACTORS
    weigh_by_gradient(scene, &e, gradient, direction);
#if OPACITY_FACTORS & OPACITY_FACTOR_FUR
    const Vectors place = {x, y, z};
    weigh_by_fur(scene, &e, gradient, place, 0.5f * (v.front + v.back));
#endif
#endif
  }
#endif
#if FIELDS
  apply_fields(look, &e);
#endif
  return select((floatN)0.0f, e.d * (1.0f / view->step), active);
}

#if ISOSURFACES
/* `depth` and that of the surfaces that the rays of a walk (in edges) meet up to `until`: where the eye's rays would
 * (surface_walk.h). */
INLINE floatN depth_of_surfaces(const Scene *scene, SurfaceWalk *walk, floatN depth, floatN until,
                                intN rays FADING_PARAMETER, Tally *counted)
{
  Tally cells = 0;
  for (;;) {
    const intN wanted = rays & MASK(depth < scene->effects->shadow_depth);
    find_surfaces(scene, walk, wanted, until, &counted[COUNT_SHADOW_SAMPLES], &cells);
    intN meets = wanted & walk->found & MASK(walk->at <= until);
    if (!any_lane(meets)) return depth;
    walk->found &= ~meets;
#if FIELDS & FIELD_MASK
    const Vectors at = surface_place(walk);
    meets = mask_keeps(scene, at.x, at.y, at.z, meets, counted);
#endif
    const intN surface = scene->effects->first_surface + 3 * walk->surface;
    const floatN added = select((floatN)0.0f, AS_FLOAT(gather4(scene->items, 4 * surface + 3)), meets);
#if FADES_WITH_DISTANCE
    fade_depth(fading, added, walk->ray.entry_depth + walk->at, meets);
#endif
    depth += added;
  }
}
#endif

/* `depth` and what one kept stretch of the rays adds. Surfaces count from `apart` edges on. */
INLINE floatN depth_along(const Scene *scene, const Rays *ray, Vectors direction, floatN depth, float apart,
                          intN rays FADING_PARAMETER, Tally *counted)
{
  const float h = scene->effects->shadow_step, enough = scene->effects->shadow_depth;
  const floatN segments = select((floatN)0.0f, ceil(ray->length), rays & MASK(ray->length > 0.0f));
  const intN last = TO_INT(segments) - 1;
  intN i = 0;
#if SHADOW_ENDS
  intN joined = 0; /* the values at the segment's start, and one step before, are known */
  floatN value1 = 0.0f, value2 = 0.0f;
#endif
#if ISOSURFACES
  const Rays in_edges = rays_in_steps(*ray, 1.0f / h);
  SurfaceWalk walk = walk_along(in_edges, lane_min((floatN)apart, 0.5f * in_edges.length));
#if !FADES_WITH_DISTANCE /* the order does not matter */
  depth = depth_of_surfaces(scene, &walk, depth, (floatN)INFINITY, MASK(i <= last), counted);
#endif
#endif
  for (;;) {
    const intN going = MASK(i <= last) & MASK(depth < enough);
    if (!any_lane(going)) break;
#if SKIP_EMPTY
    /* The segment before the first visible one is taken too: for the curvature. */
    const floatN visible_at = next_visible(scene->distances, scene->view, TO_FLOAT(i), ray->length, going, ray, counted);
    const floatN to = lane_clamp(visible_at - (float)SHADOW_ENDS, (floatN)0.0f, TO_FLOAT(max(last, (intN)0)) + 1.0f);
    const intN leaps = going & MASK(TO_INT(to) > i);
    i = select(i, TO_INT(to), leaps);
    i = select(i, last + 1, going & MASK(visible_at >= ray->length));
#if SHADOW_ENDS
    joined &= ~leaps;
#endif
#endif
#if SHADOW_RUNS
    floatN values[SHADOW_STEPS];
    values_of_segments(scene, ray, min(i, max(last, (intN)0)), last, SHADOW_ENDS, going, values);
#endif
    _Pragma("unroll 1") for (int step = 0; step < SHADOW_STEPS; ++step) {
      const intN active = MASK(i <= last) & MASK(depth < enough);
      if (!any_lane(active)) break;
      const floatN t0 = TO_FLOAT(min(i, max(last, (intN)0)));
      const floatN length = select((floatN)0.0f, lane_min(ray->length - t0, (floatN)1.0f), active);
#if SHADOW_ENDS
      const floatN at = t0 + length;
      floatN front = value1, value = 0.0f;
      const intN opens = active & ~joined;
      _Pragma("unroll 1") for (int k = any_lane(opens) ? 0 : 1; k < 2; ++k) {
#if SHADOW_RUNS
        value = k ? values[step] : value_along(scene, ray, t0);
#else
        value = value_along(scene, ray, k ? at : t0);
#endif
        if (k == 0) front = select(front, value, opens), count_lanes(&counted[COUNT_SHADOW_SAMPLES], opens);
      }
      SegmentValues v = {front, value};
      shift_ends(value2, &v.front, &v.back, select((floatN)1.0f, length, active), active & joined);
      value2 = select(value2, front, active), value1 = select(value1, value, active);
      joined |= active;
#elif CLASSIFICATION == CLASSIFICATION_PRE
      const floatN at = t0 + 0.5f * length, value = 0.0f;
      const SegmentValues v = {value, value};
#else
#if SHADOW_RUNS
      const floatN value = values[step];
#else
      const floatN value = value_along(scene, ray, t0 + 0.5f * length);
#endif
      const SegmentValues v = {value, value};
#endif
      count_lanes(&counted[COUNT_SHADOW_SAMPLES], active);
#if FADES_WITH_DISTANCE
      const floatN added = h * length * extinction_along(scene, ray, t0, t0 + length, v, direction, active, counted);
#if ISOSURFACES
      depth = depth_of_surfaces(scene, &walk, depth, h * (t0 + length), active, fading, counted);
#endif
      fade_depth(fading, added, ray->entry_depth + h * (t0 + 0.5f * length), active);
      depth += added;
#else
      depth += h * length * extinction_along(scene, ray, t0, t0 + length, v, direction, active, counted);
#endif
      i -= active;
    }
  }
  return depth;
}

/* Optical depth from `place` (lattice) along `direction` (local, of unit length), `reach` edges at most. */
INLINE floatN depth_towards(const Scene *scene, Vectors place, Vectors direction, floatN reach,
                            intN rays FADING_PARAMETER, Tally *counted)
{
  const Rays whole = rays_towards(scene, place, direction, reach, rays);
  const float apart = FADES_WITH_DISTANCE ? 0.0f : SURFACE_OFFSET; /* those begin on no surface */
  count_lanes(&counted[COUNT_SHADOW_RAYS], rays);
#if CLIP
  floatN depth = 0.0f, next_from = 0.0f;
  intN open = MASK(whole.length > 0.0f);
  _Pragma("unroll 1") for (int stretch = 0;; ++stretch) {
    const Stretch kept = next_stretch(scene, &whole, next_from, scene->effects->shadow_step);
    open &= MASK(kept.enter < kept.leave);
    if (!any_lane(open)) return depth;
    const Rays ray = ray_along(&whole, kept.enter, kept.leave, open, scene->effects->shadow_step);
    next_from = select(next_from, kept.leave, open);
    depth = depth_along(scene, &ray, direction, depth, stretch ? 0.0f : apart, open FADING_ARGUMENT, counted);
    open &= MASK(depth < scene->effects->shadow_depth);
  }
#else
  return depth_along(scene, &whole, direction, (floatN)0.0f, apart, rays FADING_ARGUMENT, counted);
#endif
}

#if !FADES_WITH_DISTANCE

/* How far it is to a light, in edges, from a local place. */
INLINE floatN distance_to_light(float4 light, Vectors here)
{
  if (!light_has_place(light)) return (floatN)INFINITY;
  const Vectors way = {light.x - here.x, light.y - here.y, light.z - here.z};
  return sqrt(dot3(way, way));
}

/* The share of a light, colour by colour, that arrives at `place` (lattice). towards: unit vector to the light
 * (local). light: its first item. index: its number in the light volume. weight: what the sample counts for in the
 * picture. */
INLINE Vectors light_that_arrives(const Scene *scene, Vectors place, Vectors towards, float4 light, int index,
                                  floatN weight,
                                  intN faces, Tally *counted)
{
  __constant const Effects *e = scene->effects;
  Vectors share;
#if SHADOWS == SHADOWS_VOLUME
  const LightCell c = light_cell(place.x, place.y, place.z, e->light_grid, e->light_size, LIGHT_CHANNELS);
  __global const float *volume = (__global const float *)scene->light_volume + (size_t)index * c.slice * e->light_size.z;
  share.x = light_between(volume, c, LIGHT_CHANNELS);
#if SCATTERING
  share.y = light_between(volume + 1, c, LIGHT_CHANNELS);
  share.z = light_between(volume + 2, c, LIGHT_CHANNELS);
#else
  share.y = share.z = share.x;
#endif
#elif SHADOWS == SHADOWS_HALF_ANGLE
  share = light_of_slab(scene, place);
#else
  const intN cast = faces & MASK(weight > e->shadow_bound);
  share.x = share.y = share.z = 1.0f;
  if (any_lane(cast)) {
    const floatN reach = distance_to_light(light, to_local(e, place.x, place.y, place.z));
    const floatN through = 1.0f - opacity_of_depth(depth_towards(scene, place, towards, reach, cast, counted));
    share.x = select(share.x, through, cast);
    share.y = share.z = share.x;
  }
#endif
  return share;
}

#endif

#endif
