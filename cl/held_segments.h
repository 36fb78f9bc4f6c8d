/* Segments of a packet's rays whose opacity is composited and whose colour is not yet.
 *
 * Opacity does not depend on colour, so segments are held until there are many. Those that light has to be found for
 * are then an entry each, packed: whatever ray and segment it is of, no lane is spent on one that shows nothing.
 * lit_entries.h finds their colours.
 */
#ifndef HELD_SEGMENTS_H
#define HELD_SEGMENTS_H

#include "composite.h"
#include "emission.h"
#include "lanes.h"
#include "march.h"
#include "rays.h"
#include "scene.h"
#include "vectors.h"

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
} HeldSegments;

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

#endif
