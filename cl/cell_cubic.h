/* Surfaces in a cell of the linear filter. Along a ray the field is a cubic there; its Bernstein coefficients are
 * means of the field's values at the eight corners of the box that the stretch through the cell is the diagonal of
 * (the blossom of the trilinear form). A cell whose voxels are all on one side of every iso-value has no surface; in
 * the others the cubic is cut where it turns (Marmitt et al. 2004), and what changes side on a piece has exactly one
 * root there.
 */
#ifndef CELL_CUBIC_H
#define CELL_CUBIC_H

#include "lanes.h"
#include "sample_volume.h"
#include "scene.h"
#include "surface_levels.h"
#include "vectors.h"

#define ROOT_SHARE 1e-6f /* of a cell: to this roots are found */

#if BLOCKS
#include "cell_blocks.h"
#define decode_cell(voxels, view) (voxels)
#else
typedef FetchedCorners CellVoxels;
#define fetch_cell fetch_corners
#define decode_cell decode_corners
#endif

/* Exact at both ends: what two cells make of the face between them is the same, bit for bit. */
INLINE floatN mix_ends(floatN a, floatN b, floatN u) { return select(a + u * (b - a), b, MASK(u == 1.0f)); }

typedef struct {
  floatN b0, b3, p1, p2, p3; /* first and last value; b0 + w (p1 + w (p2 + w p3)) */
  floatN w1, w2;             /* where it turns, w1 <= w2; 0 or 1 where it does not */
  intN turns;
} CellCurve;

INLINE floatN curve_value(const CellCurve *f, floatN w)
{
  return select(f->b0 + w * (f->p1 + w * (f->p2 + w * f->p3)), f->b3, MASK(w == 1.0f));
}

/* From the place `low` in the cell to the place `high`, 0 .. 1 along each axis. */
INLINE CellCurve cell_curve(const Corners *c, Vectors low, Vectors high, intN active)
{
  const floatN l00 = mix_ends(c->v000, c->v100, low.x), l10 = mix_ends(c->v010, c->v110, low.x);
  const floatN l01 = mix_ends(c->v001, c->v101, low.x), l11 = mix_ends(c->v011, c->v111, low.x);
  const floatN h00 = mix_ends(c->v000, c->v100, high.x), h10 = mix_ends(c->v010, c->v110, high.x);
  const floatN h01 = mix_ends(c->v001, c->v101, high.x), h11 = mix_ends(c->v011, c->v111, high.x);
  const floatN ll0 = mix_ends(l00, l10, low.y), ll1 = mix_ends(l01, l11, low.y);
  const floatN lh0 = mix_ends(l00, l10, high.y), lh1 = mix_ends(l01, l11, high.y);
  const floatN hl0 = mix_ends(h00, h10, low.y), hl1 = mix_ends(h01, h11, low.y);
  const floatN hh0 = mix_ends(h00, h10, high.y), hh1 = mix_ends(h01, h11, high.y);
  const floatN hll = mix_ends(hl0, hl1, low.z), lhl = mix_ends(lh0, lh1, low.z), llh = mix_ends(ll0, ll1, high.z);
  const floatN hhl = mix_ends(hh0, hh1, low.z), hlh = mix_ends(hl0, hl1, high.z), lhh = mix_ends(lh0, lh1, high.z);
  CellCurve f;
  f.b0 = mix_ends(ll0, ll1, low.z), f.b3 = mix_ends(hh0, hh1, high.z);
  const floatN b1 = hll + ((lhl - hll) + (llh - hll)) * (1.0f / 3.0f);
  const floatN b2 = hhl + ((hlh - hhl) + (lhh - hhl)) * (1.0f / 3.0f);
  const floatN d0 = b1 - f.b0, d1 = b2 - b1, d2 = f.b3 - b2;
  f.p1 = 3.0f * d0, f.p2 = 3.0f * (d1 - d0), f.p3 = (d2 - d1) - (d1 - d0);
  const intN one_way = (MASK(d0 >= 0.0f) & MASK(d1 >= 0.0f) & MASK(d2 >= 0.0f)) |
      (MASK(d0 <= 0.0f) & MASK(d1 <= 0.0f) & MASK(d2 <= 0.0f));
  f.turns = active & ~one_way;
  f.w1 = 1.0f, f.w2 = 1.0f;
  if (any_lane(f.turns)) {
    const floatN largest = lane_max(lane_max(fabs(d0), fabs(d1)), fabs(d2));
    const floatN scale = 1.0f / select((floatN)1.0f, largest, f.turns);
    const floatN e0 = d0 * scale, e1 = d1 * scale, e2 = d2 * scale;
    const floatN curve = (e0 - e1) + (e2 - e1), slope = 2.0f * (e1 - e0), under = slope * slope - 4.0f * curve * e0;
    const floatN root = sqrt(lane_max(under, (floatN)0.0f));
    const floatN q = -0.5f * (slope + select(root, -root, MASK(slope < 0.0f)));
    /* Infinite or not a number where there is no second one: 0 or 1 then. */
    const floatN zero = 0.0f, one = 1.0f, r1 = lane_clamp(q / curve, zero, one), r2 = lane_clamp(e0 / q, zero, one);
    f.w1 = select(one, lane_min(r1, r2), f.turns & MASK(under > 0.0f));
    f.w2 = select(one, lane_max(r1, r2), f.turns & MASK(under > 0.0f));
  }
  return f;
}

/* Where the curve takes the bracket's level: Newton's steps where they stay in the bracket, else halves of it. */
INLINE floatN curve_root(const CellCurve *f, Bracket k, intN open)
{
  const floatN base = f->b0 - k.level;
  const intN rises = MASK(k.vb >= k.va);
  floatN w = k.a + (k.level - k.va) / select((floatN)1.0f, k.vb - k.va, open) * (k.b - k.a);
  _Pragma("unroll 1") for (int i = 0; i < 40 && any_lane(open); ++i) {
    const floatN miss = base + w * (f->p1 + w * (f->p2 + w * f->p3));
    const floatN slope = f->p1 + w * (2.0f * f->p2 + 3.0f * w * f->p3);
    const intN behind = ~(MASK(miss >= 0.0f) ^ rises);
    k.b = select(k.b, w, open & behind), k.a = select(k.a, w, open & ~behind);
    floatN next = w - miss / slope;
    next = select(0.5f * (k.a + k.b), next, MASK(next >= k.a) & MASK(next <= k.b));
    const intN moves = MASK(fabs(next - w) > ROOT_SHARE);
    w = select(w, next, open);
    open &= moves;
  }
  return w;
}

#if VOXEL_HOLES
/* A stretch in a face of the cell does not use the voxels off that face. */
INLINE void drop_unused(floatN *v0, floatN *v1, floatN low, floatN high)
{
  *v1 = select(*v1, *v0, MASK(low == 0.0f) & MASK(high == 0.0f));
  *v0 = select(*v0, *v1, MASK(low == 1.0f) & MASK(high == 1.0f));
}
#endif

/* The first surface in the cell, from `rank` of piece number `piece` on. A cell that uses a voxel that is not finite
 * has none. */
INLINE CellHit look_in_cell(const Scene *scene, CellVoxels voxels, Vectors low, Vectors high, intN piece, intN rank,
                            intN open)
{
  CellHit hit = no_hit();
  Corners c = decode_cell(voxels, scene->view);
#if VOXEL_HOLES
  drop_unused(&c.v000, &c.v100, low.x, high.x), drop_unused(&c.v010, &c.v110, low.x, high.x);
  drop_unused(&c.v001, &c.v101, low.x, high.x), drop_unused(&c.v011, &c.v111, low.x, high.x);
  drop_unused(&c.v000, &c.v010, low.y, high.y), drop_unused(&c.v100, &c.v110, low.y, high.y);
  drop_unused(&c.v001, &c.v011, low.y, high.y), drop_unused(&c.v101, &c.v111, low.y, high.y);
  drop_unused(&c.v000, &c.v001, low.z, high.z), drop_unused(&c.v100, &c.v101, low.z, high.z);
  drop_unused(&c.v010, &c.v011, low.z, high.z), drop_unused(&c.v110, &c.v111, low.z, high.z);
  open &= finite_lanes((c.v000 - c.v000) + (c.v100 - c.v100) + (c.v010 - c.v010) + (c.v110 - c.v110) +
                       (c.v001 - c.v001) +
                       (c.v101 - c.v101) + (c.v011 - c.v011) + (c.v111 - c.v111));
#endif
  const floatN lowest = lane_min(lane_min(lane_min(c.v000, c.v100), lane_min(c.v010, c.v110)),
                                 lane_min(lane_min(c.v001, c.v101), lane_min(c.v011, c.v111)));
  const floatN highest = lane_max(lane_max(lane_max(c.v000, c.v100), lane_max(c.v010, c.v110)),
                                  lane_max(lane_max(c.v001, c.v101), lane_max(c.v011, c.v111)));
  open &= meets_a_surface(scene, lowest, highest);
  if (!any_lane(open)) return hit;
  const CellCurve f = cell_curve(&c, low, high, open);
  Bracket bracket = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
  floatN a = 0.0f, va = f.b0;
  const int pieces = any_lane(f.turns) ? 3 : 1;
  _Pragma("unroll 1") for (int p = 0; p < pieces; ++p) {
    const floatN b = p == 0 ? f.w1 : p == 1 ? f.w2 : (floatN)1.0f, vb = curve_value(&f, b);
    const intN from = select((intN)0, rank, MASK(piece == p));
    find_between(scene, (intN)p, a, b, va, vb, from, open & MASK(piece <= p), &hit, &bracket);
    a = b, va = vb;
  }
  if (any_lane(hit.found)) hit.share = curve_root(&f, bracket, hit.found);
  return hit;
}

#endif
