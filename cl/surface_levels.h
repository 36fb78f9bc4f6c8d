/* Iso-values: which of them a value passes, and in which order. The items of the surfaces are described in
 * surfaces.h. */
#ifndef SURFACE_LEVELS_H
#define SURFACE_LEVELS_H

#include "effects.h"
#include "lanes.h"
#include "scene.h"

/* What was found in a cell: lanes, the surface's number, whether the value rises through it, where (a share of the
 * ray's stretch through the cell), and the piece of the stretch and the place among the surfaces that a later search
 * goes on at. */
typedef struct {
  intN found, surface, rising, piece, rank;
  floatN share;
} CellHit;

INLINE CellHit no_hit(void)
{
  CellHit hit;
  hit.found = hit.surface = hit.rising = hit.piece = hit.rank = 0;
  hit.share = 0.0f;
  return hit;
}

/* A piece of a ray on which the value runs one way, from va to vb, and which it takes `level` on. */
typedef struct {
  floatN a, b, va, vb, level;
} Bracket;

INLINE float iso_value(const Scene *scene, int k) { return scene->items[scene->effects->first_surface + 3 * k].x; }

/* Lanes in which some iso-value lies between low and high. */
INLINE intN meets_a_surface(const Scene *scene, floatN low, floatN high)
{
  intN meets = 0;
  _Pragma("unroll 1") for (int k = 0; k < scene->effects->surface_count; ++k) {
    const float level = iso_value(scene, k);
    meets |= MASK(low < level) & MASK(high >= level);
  }
  return meets;
}

/* Adds to `hit` and `bracket` the first surface that the values from va to vb, on piece number `piece`, change sides
 * of: a place is above a surface where its value is at least the iso-value. In the order along the ray, ascending
 * where values rise, beginning at the `rank`-th of that order. */
INLINE void find_between(const Scene *scene, intN piece, floatN a, floatN b, floatN va, floatN vb, intN rank,
                         intN open, CellHit *hit,
                         Bracket *bracket)
{
  const int surfaces = scene->effects->surface_count;
  const intN rises = MASK(vb >= va);
  _Pragma("unroll 1") for (int r = 0; r < surfaces; ++r) {
    const floatN level = select((floatN)iso_value(scene, surfaces - 1 - r), (floatN)iso_value(scene, r), rises);
    const intN crosses = open & ~hit->found & MASK(rank <= r) & (MASK(va >= level) ^ MASK(vb >= level));
    if (!any_lane(crosses)) continue;
    hit->found |= crosses;
    hit->surface = select(hit->surface, select((intN)(surfaces - 1 - r), (intN)r, rises), crosses);
    hit->rising = select(hit->rising, rises, crosses);
    hit->piece = select(hit->piece, piece, crosses), hit->rank = select(hit->rank, (intN)(r + 1), crosses);
    bracket->a = select(bracket->a, a, crosses), bracket->b = select(bracket->b, b, crosses);
    bracket->va = select(bracket->va, va, crosses), bracket->vb = select(bracket->vb, vb, crosses);
    bracket->level = select(bracket->level, level, crosses);
  }
}

#endif
