/* The colours of held segments' entries (held_segments.h), in light, a few vectors of entries at a time.
 *
 * Gradients and light are a chain of some three hundred operations per vector, of which each waits for the one before,
 * and a processor looks only a few hundred instructions ahead. So each stage is a short loop of its own over TOGETHER
 * vectors: places, the fetches of gradients, gradients, normals, each light's cosines, powers (two at a time), sums.
 */
#ifndef LIT_ENTRIES_H
#define LIT_ENTRIES_H

#include "held_segments.h"
#include "scene_value.h"
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

#define TOGETHER 4 /* even */

/* Whether light is simple enough for that: any number of lights, no shadows, no environment, no occlusion. */
#define STAGED_LIGHT (LIGHTING && LIGHTS && !SHADOWS && !ENVIRONMENT && !AMBIENT_OCCLUSION)

/* Between which places along rays, in their steps, gradients need no voxel beyond the volume's faces. What is near the
 * faces is left out: rounding of places does not matter. */
typedef struct {
  floatN from, to;
} InnerSpan;

INLINE void cut_inner(InnerSpan *span, floatN x0, floatN rx, floatN still, int size)
{
  const float margin = 0.01f + 1e-6f * (float)size;
  const float low = 1.0f + margin, high = (float)(size - 2) - margin;
  const floatN a = (low - x0) * rx, b = (high - x0) * rx;
  const intN moves = MASK(still == 0.0f), inside = MASK(x0 >= low) & MASK(x0 <= high);
  span->from = select(span->from, lane_max(span->from, lane_min(a, b)), moves);
  span->to = select(span->to, lane_min(span->to, lane_max(a, b)), moves);
  span->to = select(span->to, -(floatN)INFINITY, (~moves & ~inside) | MASK((floatN)low > (floatN)high));
}

INLINE InnerSpan inner_span(__constant const View *view, const Rays *ray)
{
  InnerSpan span = {-(floatN)INFINITY, (floatN)INFINITY};
  cut_inner(&span, ray->x0, ray->rx, ray->px, view->size.x);
  cut_inner(&span, ray->y0, ray->ry, ray->py, view->size.y);
  cut_inner(&span, ray->z0, ray->rz, ray->pz, view->size.z);
  return span;
}

#if LIGHTING
/* The gradients of `count` vectors of entries from the k-th on. */
INLINE void entry_gradients(const Scene *scene, const HeldSegments *held, int k, int count, const Rays *ray,
                            InnerSpan inner, Vectors *gradients)
{
#if GRADIENTS_IN_STAGES && FILTER == FILTER_LINEAR
  __constant const View *view = scene->view;
  GradientWords words[TOGETHER];
  intN corners[TOGETHER];
  uint beside = 0; /* vectors that have an entry at the volume's faces, as bits */
  _Pragma("unroll 1") for (int j = 0; j < count; ++j) {
    const Entries entries = entries_at(held, k + LANES * j, ray);
    const Vectors p = places_of(entries, ray);
    const intN at_faces = MASK(entries.t < permuted_lanes(inner.from, entries.lane)) |
        MASK(entries.t > permuted_lanes(inner.to, entries.lane));
    const intN ix = TO_INT(p.x), iy = TO_INT(p.y), iz = TO_INT(p.z);
    beside |= (uint)(any_lane(at_faces) != 0) << j;
    /* There it is not used, but has to be fetched from somewhere. */
    corners[j] = select(corner_offset(scene->volume, view, ix, iy, iz),
                        (intN)(view->slice_stride + view->row_stride + 1), at_faces);
    words[j].fx = p.x - TO_FLOAT(ix), words[j].fy = p.y - TO_FLOAT(iy), words[j].fz = p.z - TO_FLOAT(iz);
  }
  _Pragma("unroll 1") for (int j = 0; j < count; ++j) fetch_gradient_words(scene->volume, view, corners[j], &words[j]);
  _Pragma("unroll 1") for (int j = 0; j < count; ++j) {
    if (beside >> j & 1u) {
      const Vectors p = places_of(entries_at(held, k + LANES * j, ray), ray);
      gradients[j] = scene_gradient(scene, p.x, p.y, p.z);
    } else {
      const Gradient g = gradient_of_words(words[j]);
      gradients[j] = gradient_to_local(scene->effects, g.x, g.y, g.z);
    }
  }
#else
  _Pragma("unroll 1") for (int j = 0; j < count; ++j) {
    const Vectors p = places_of(entries_at(held, k + LANES * j, ray), ray);
    gradients[j] = scene_gradient(scene, p.x, p.y, p.z);
  }
#endif
}
#endif

#if LIGHTING && BLOCKS && LANES > 1
/* Of all entries at once: those of a kind are many (gradient_queue.h). */
typedef struct {
  float x[MOST_ENTRIES], y[MOST_ENTRIES], z[MOST_ENTRIES];
} EntryGradients;

INLINE void block_entry_gradients(const Scene *scene, const HeldSegments *held, const Rays *ray, EntryGradients *g)
{
  _Pragma("unroll 1") for (int k = 0; k < held->entries; k += LANES) {
    const Vectors place = places_of(entries_at(held, k, ray), ray);
    STORE_LANES(place.x, g->x + k), STORE_LANES(place.y, g->y + k), STORE_LANES(place.z, g->z + k);
  }
  blocks_gradients(&scene->blocks, held->entries, g->x, g->y, g->z, BLOCK_TALLIES(scene->tallies));
}
#endif

#if STAGED_LIGHT

/* What light finds of a vector of entries: as illuminate() of shade.h. */
typedef struct {
  Vectors normal;
  floatN facing, cosine, aligned;
  intN lit, lightable, faces;
  Illumination light;
#if AIMED_LIGHTS
  Vectors share;
#endif
} EntryLight;

/* Adds the light of one of the scene's to `count` vectors. */
INLINE void add_light(const Scene *scene, int item, float4 at, float4 intensity, const HeldSegments *held, int k, int count,
                      const Rays *ray, Vectors forward, EntryLight *entries)
{
  __constant const Effects *e = scene->effects;
  const Vectors to_eye = scaled3(forward, -1.0f);
  /* Towards a point light directions differ, else each ray has one. */
  const Vectors along_ray = at.w == LIGHT_HEADLIGHT ? to_eye : broadcast3(at);
#if SPECULAR
  /* N.H, with |L + V| = sqrt(2 + 2 L.V) */
  const floatN ray_scale = lane_rsqrt(lane_max(2.0f + 2.0f * dot3(along_ray, to_eye), (floatN)1e-12f));
#endif
  _Pragma("unroll 1") for (int j = 0; j < count; ++j) {
    EntryLight *lit = entries + j;
    const intN lane = TO_INT(LOAD_LANES(held->lane + k + LANES * j));
    Vectors towards = broadcast3(at);
    if (at.w == LIGHT_HEADLIGHT) towards = permuted3(to_eye, lane);
#if SPECULAR
    floatN scale = permuted_lanes(ray_scale, lane);
#endif
    if (light_has_place(at)) {
      const Vectors place = places_of(entries_at(held, k + LANES * j, ray), ray);
      const Vectors here = to_local(e, place.x, place.y, place.z);
      const Vectors from = {at.x - here.x, at.y - here.y, at.z - here.z};
      towards = unit3(from);
#if SPECULAR
      scale = lane_rsqrt(lane_max(2.0f + 2.0f * dot3(towards, permuted3(to_eye, lane)), (floatN)1e-12f));
#endif
    }
    lit->cosine = lane_max(dot3(lit->normal, towards), (floatN)0.0f);
    lit->faces = lit->lightable & MASK(lit->cosine > 0.0f);
#if AIMED_LIGHTS
    lit->share = aimed_share(scene, item, at.w, towards);
#endif
#if SPECULAR
    lit->aligned = lane_clamp((lit->cosine + lit->facing) * scale, (floatN)0.0f, (floatN)1.0f);
#endif
  }
#if SPECULAR
  _Pragma("unroll 1") for (int j = 0; j < count; j += 2)
    lane_powers(entries[j].aligned, entries[j + 1].aligned, e->shininess, &entries[j].aligned, &entries[j + 1].aligned);
#endif
  _Pragma("unroll 1") for (int j = 0; j < count; ++j) {
    EntryLight *lit = entries + j;
    Vectors color = broadcast3(intensity);
#if AIMED_LIGHTS
    color.x *= lit->share.x, color.y *= lit->share.y, color.z *= lit->share.z;
#endif
    const floatN diffuse = select((floatN)0.0f, e->diffuse * lit->cosine, lit->faces);
    lit->light.diffuse.x += diffuse * color.x, lit->light.diffuse.y += diffuse * color.y;
    lit->light.diffuse.z += diffuse * color.z;
#if SPECULAR
    const floatN shine = select((floatN)0.0f, e->specular * lit->aligned, lit->faces);
    lit->light.specular.x += shine * color.x, lit->light.specular.y += shine * color.y;
    lit->light.specular.z += shine * color.z;
#endif
  }
}

/* What `count` vectors of entries from the k-th on are multiplied by, and what is added to them. */
INLINE void light_entries(const Scene *scene, const HeldSegments *held, int k, int count, const Rays *ray,
                          Vectors forward, Vectors cut_normal, const Vectors *gradients, EntryLight *entries)
{
  __constant const Effects *e = scene->effects;
  _Pragma("unroll 1") for (int j = 0; j < count; ++j) {
    const int at = k + LANES * j;
    const Entries places = entries_at(held, at, ray);
    Vectors normal = shown_normal(scene, gradients[j], permuted3(cut_normal, places.lane),
                                  places.t * scene->view->step);
    EntryLight lit;
    lit.lit = MASK(at + LANE_INDEX < held->entries) & MASK(dot3(normal, normal) > 0.5f);
    const Vectors view = scaled3(permuted3(forward, places.lane), -1.0f);
    floatN facing = dot3(normal, view);
    const intN turned = MASK(facing < 0.0f) & (e->two_sided ? (intN)-1 : (intN)0);
    lit.normal = select3(normal, scaled3(normal, -1.0f), turned);
    lit.facing = select(facing, -facing, turned);
    lit.lightable = lit.lit & MASK(lit.facing >= 0.0f);
    lit.light.diffuse.x = lit.light.diffuse.y = lit.light.diffuse.z = e->ambient;
    lit.light.specular.x = lit.light.specular.y = lit.light.specular.z = 0.0f;
    lit.cosine = lit.aligned = 0.0f, lit.faces = 0;
    entries[j] = lit;
  }
  if (count & 1) entries[count].aligned = 0.0f; /* powers are taken of two */
  _Pragma("unroll 1") for (int light = 0; light < e->light_count; ++light) {
    const int item = e->first_light + LIGHT_ROWS * light;
    add_light(scene, item, scene->items[item], scene->items[item + 1], held, k, count, ray, forward, entries);
  }
}

#endif

/* Finds the colours of all that is held, in light. */
INLINE void color_entries(const Scene *scene, HeldSegments *held, const Rays *ray, InnerSpan inner, Vectors forward,
                          Vectors cut_normal, Tally *counted)
{
#if LIGHTING && BLOCKS && LANES > 1
  EntryGradients all;
  block_entry_gradients(scene, held, ray, &all);
#endif
  _Pragma("unroll 1") for (int k = 0; k < held->entries; k += LANES * TOGETHER) {
    const int count = min((held->entries - k + LANES - 1) / LANES, TOGETHER);
#if LIGHTING
    Vectors gradients[TOGETHER];
#endif
#if LIGHTING && BLOCKS && LANES > 1
    _Pragma("unroll 1") for (int j = 0; j < count; ++j)
      gradients[j] = gradient_to_local(scene->effects, LOAD_LANES(all.x + k + LANES * j),
                                       LOAD_LANES(all.y + k + LANES * j), LOAD_LANES(all.z + k + LANES * j));
#elif LIGHTING
    entry_gradients(scene, held, k, count, ray, inner, gradients);
#endif
#if STAGED_LIGHT
    EntryLight entries[TOGETHER];
    light_entries(scene, held, k, count, ray, forward, cut_normal, gradients, entries);
#endif
    _Pragma("unroll 1") for (int j = 0; j < count; ++j) {
      const int at = k + LANES * j;
      Vectors color = {LOAD_LANES(held->r + at), LOAD_LANES(held->g + at), LOAD_LANES(held->b + at)};
      const floatN opacity = LOAD_LANES(held->opacity + at);
#if STAGED_LIGHT
      count_lanes(&counted[COUNT_LIT_SAMPLES], entries[j].lit);
      color = in_light(scene, color, color, opacity, gradients[j], entries[j].light, entries[j].lit);
#elif LIGHTING
      const Entries places = entries_at(held, at, ray);
      const Vectors normal = shown_normal(scene, gradients[j], permuted3(cut_normal, places.lane),
                                          places.t * scene->view->step);
      const intN lit = MASK(at + LANE_INDEX < held->entries) & MASK(dot3(normal, normal) > 0.5f);
      floatN weight = 0.0f;
#if SHADOWS
      weight = LOAD_LANES(held->weight + at);
#endif
      color = shaded_color(scene, color, opacity, places_of(places, ray), normal, gradients[j],
                           scaled3(permuted3(forward, places.lane), -1.0f), weight, 0, lit, counted);
#elif AMBIENT_OCCLUSION
      color = occluded_color(scene, color, places_of(entries_at(held, at, ray), ray));
#endif
#if DEPTH_CUE
      const Entries cued = entries_at(held, at, ray);
      color = cued_color(scene, color, opacity,
                         permuted_lanes(ray->entry_depth, cued.lane) + cued.t * scene->view->step);
#endif
      STORE_LANES(color.x, held->r + at), STORE_LANES(color.y, held->g + at), STORE_LANES(color.z, held->b + at);
    }
  }
}

/* The same, and composites them. */
INLINE void composite_held(const Scene *scene, HeldSegments *held, Gathered *acc, const Rays *ray,
                           InnerSpan inner, Vectors forward, Vectors cut_normal, Tally *counted)
{
  /* What is behind the last entry is not used, but needs a place. */
  STORE_LANES((floatN)0.0f, held->lane + held->entries), STORE_LANES((floatN)held->t[0], held->t + held->entries);
  color_entries(scene, held, ray, inner, forward, cut_normal, counted);
  int at = 0;
  _Pragma("unroll 1") for (int k = 0; k < held->segments; ++k) {
    const uint bits = held->lanes[k];
    Vectors color = {unpack_lanes(held->r + at, bits), unpack_lanes(held->g + at, bits),
                     unpack_lanes(held->b + at, bits)};
#if CONSTANT_CELLS
    const Vectors plain = {held->plain_r[k], held->plain_g[k], held->plain_b[k]};
    color = select3(plain, color, lanes_of(bits));
#endif
    acc->r += held->part[k] * color.x, acc->g += held->part[k] * color.y, acc->b += held->part[k] * color.z;
    at += popcount(bits);
  }
  held->segments = held->entries = 0;
}

#endif
