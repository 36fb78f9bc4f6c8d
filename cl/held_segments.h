/* Segments of a packet's rays whose opacity is composited and whose colour is not yet.
 *
 * Opacity does not depend on colour, so segments are held until there are many. Those that light has to be found for
 * are then an entry each, packed: whatever ray and segment it is of, no lane is spent on one that shows nothing.
 * Gradients are taken and lights asked in two loops over the entries, short ones, since each is a chain of a hundred
 * operations and more: a processor has several turns of a short loop under way at once.
 */
#ifndef HELD_SEGMENTS_H
#define HELD_SEGMENTS_H

#include "composite.h"
#include "emission.h"
#include "lanes.h"
#include "march.h"
#include "rays.h"
#include "scene.h"
#include "scene_value.h"
#include "vectors.h"
#if LIGHTING
#include "shade.h"
#endif
#if DEPTH_CUE
#include "depth_cue.h"
#endif

/* The middle of the segment that begins at `t0` of a ray of `length`. */
INLINE floatN segment_middle(floatN t0, floatN length) { return t0 + 0.5f * (lane_min(t0 + 1.0f, length) - t0); }

#define MOST_HELD (4 * MARCH_STEPS)
#define MOST_ENTRIES (LANES * MOST_HELD + LANES)
typedef struct {
  int segments, entries;
  uint lanes[MOST_HELD];  /* rays that have an entry for the segment, as bits */
  floatN part[MOST_HELD]; /* what its colour counts for */
#if CONSTANT_CELLS
  floatN plain_r[MOST_HELD], plain_g[MOST_HELD], plain_b[MOST_HELD]; /* its colour without entries */
#endif
  float lane[MOST_ENTRIES], t[MOST_ENTRIES]; /* the ray, and where its segment begins */
  float r[MOST_ENTRIES], g[MOST_ENTRIES], b[MOST_ENTRIES], opacity[MOST_ENTRIES]; /* of a whole step */
#if SHADOWS
  float weight[MOST_ENTRIES]; /* what it counts for at most */
#endif
#if LIGHTING
  float gx[MOST_ENTRIES], gy[MOST_ENTRIES], gz[MOST_ENTRIES]; /* gradient */
#endif
} HeldSegments;

#if LIGHTING
/* The normal of what the gradient belongs to; at a cut face the face's own, going over to the gradient's within one
 * edge. `inside`: edges from the start of the stretch. */
INLINE Vectors shown_normal(const Scene *scene, Vectors gradient, Vectors cut_normal, floatN inside)
{
  Vectors normal = directed3(gradient, -1.0f);
#if CLIP
  inside = lane_clamp(inside, (floatN)0.0f, (floatN)1.0f);
  const intN cut = MASK(dot3(cut_normal, cut_normal) > 0.5f) & MASK(inside < 1.0f);
  if (any_lane(cut)) {
    const intN two_sided = scene->effects->two_sided ? (intN)-1 : (intN)0;
    const intN behind = two_sided & MASK(dot3(normal, cut_normal) < 0.0f);
    const Vectors toward = select3(normal, scaled3(normal, -1.0f), behind);
    normal = select3(normal, unit3(sum3(scaled3(toward, inside), scaled3(cut_normal, 1.0f - inside))), cut);
  }
#endif
  return normal;
}
#endif

INLINE Vectors permuted3(Vectors v, intN at)
{
  const Vectors r = {permuted_lanes(v.x, at), permuted_lanes(v.y, at), permuted_lanes(v.z, at)};
  return r;
}

/* Composites the opacity of a segment that begins at `t0` and is `length` steps long, for the rays in `active`, and
 * holds its colours; those in `lit` get an entry. There is room. */
INLINE void hold_segment(HeldSegments *held, Gathered *acc, Emission e, floatN t0, floatN length, intN active, intN lit)
{
  const uint bits = lane_bits(lit);
  const int at = held->entries, k = held->segments;
  const floatN left = select((floatN)0.0f, 1.0f - acc->a, active);
  floatN part = left;
  if (any_lane(active & MASK(length < 1.0f)))
    part = left * select((floatN)1.0f, share_of_opacity(e.d, length), MASK(length < 1.0f));
  acc->a += part * e.d;
  held->part[k] = part, held->lanes[k] = bits;
  held->segments = k + 1, held->entries = at + popcount(bits);
#if CONSTANT_CELLS
  held->plain_r[k] = e.r, held->plain_g[k] = e.g, held->plain_b[k] = e.b;
  if (!bits) return;
#endif
  pack_lanes(TO_FLOAT((intN)LANE_INDEX), bits, held->lane + at), pack_lanes(t0, bits, held->t + at);
  pack_lanes(e.r, bits, held->r + at), pack_lanes(e.g, bits, held->g + at), pack_lanes(e.b, bits, held->b + at);
  pack_lanes(e.d, bits, held->opacity + at);
#if SHADOWS
  pack_lanes(left * e.d, bits, held->weight + at);
#endif
}

/* Which rays' some entries are, and where: the middles of their segments. */
typedef struct {
  intN lane;
  floatN t;
} Entries;

INLINE Entries entries_at(const HeldSegments *held, int k, const Rays *ray)
{
  Entries e;
  e.lane = TO_INT(LOAD_LANES(held->lane + k));
  e.t = segment_middle(LOAD_LANES(held->t + k), permuted_lanes(ray->length, e.lane));
  return e;
}

INLINE Vectors places_of(Entries e, const Rays *ray)
{
  const Vectors p = {permuted_lanes(ray->x0, e.lane) + e.t * permuted_lanes(ray->dx, e.lane),
                     permuted_lanes(ray->y0, e.lane) + e.t * permuted_lanes(ray->dy, e.lane),
                     permuted_lanes(ray->z0, e.lane) + e.t * permuted_lanes(ray->dz, e.lane)};
  return p;
}

/* Finds the colours of all that is held, in light, and composites them. */
INLINE void composite_held(const Scene *scene, HeldSegments *held, Gathered *acc, const Rays *ray, Vectors forward,
                           Vectors cut_normal, Tally *counted)
{
  /* What is behind the last entry is not used, but needs a place. */
  STORE_LANES((floatN)0.0f, held->lane + held->entries), STORE_LANES((floatN)held->t[0], held->t + held->entries);
#if LIGHTING && BLOCKS && LANES > 1
  _Pragma("unroll 1") for (int k = 0; k < held->entries; k += LANES) {
    const Vectors place = places_of(entries_at(held, k, ray), ray);
    STORE_LANES(place.x, held->gx + k), STORE_LANES(place.y, held->gy + k), STORE_LANES(place.z, held->gz + k);
  }
  blocks_gradients(&scene->blocks, held->entries, held->gx, held->gy, held->gz, BLOCK_TALLIES(scene->tallies));
  _Pragma("unroll 1") for (int k = 0; k < held->entries; k += LANES) {
    const Vectors gradient = gradient_to_local(scene->effects, LOAD_LANES(held->gx + k), LOAD_LANES(held->gy + k),
                                               LOAD_LANES(held->gz + k));
    STORE_LANES(gradient.x, held->gx + k), STORE_LANES(gradient.y, held->gy + k), STORE_LANES(gradient.z, held->gz + k);
  }
#elif LIGHTING
  _Pragma("unroll 1") for (int k = 0; k < held->entries; k += LANES) {
    const Vectors place = places_of(entries_at(held, k, ray), ray);
    const Vectors gradient = scene_gradient(scene, place.x, place.y, place.z);
    STORE_LANES(gradient.x, held->gx + k), STORE_LANES(gradient.y, held->gy + k), STORE_LANES(gradient.z, held->gz + k);
  }
#endif
  _Pragma("unroll 1") for (int k = 0; k < held->entries; k += LANES) {
    const Entries entries = entries_at(held, k, ray);
    Vectors color = {LOAD_LANES(held->r + k), LOAD_LANES(held->g + k), LOAD_LANES(held->b + k)};
    const floatN opacity = LOAD_LANES(held->opacity + k), edges = entries.t * scene->view->step;
#if LIGHTING
    const Vectors gradient = {LOAD_LANES(held->gx + k), LOAD_LANES(held->gy + k), LOAD_LANES(held->gz + k)};
    const Vectors normal = shown_normal(scene, gradient, permuted3(cut_normal, entries.lane), edges);
    const intN lit = MASK(k + LANE_INDEX < held->entries) & MASK(dot3(normal, normal) > 0.5f);
    floatN weight = 0.0f;
#if SHADOWS
    weight = LOAD_LANES(held->weight + k);
#endif
    color = shaded_color(scene, color, opacity, places_of(entries, ray), normal, gradient,
                         scaled3(permuted3(forward, entries.lane), -1.0f), weight, 0, lit, counted);
#endif
#if DEPTH_CUE
    color = cued_color(scene, color, opacity, permuted_lanes(ray->entry_depth, entries.lane) + edges);
#endif
    STORE_LANES(color.x, held->r + k), STORE_LANES(color.y, held->g + k), STORE_LANES(color.z, held->b + k);
  }
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
