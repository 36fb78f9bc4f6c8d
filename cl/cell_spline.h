/* Surfaces in a cell of the filters of 64 voxels. Along a ray the field is a polynomial of degree 9 there, whose
 * Bernstein coefficients are found axis by axis: the four voxels of a row give those of the row's cubic in the cell,
 * the polar form (blossom) at the ends of the stretch those of the stretch's box, and the stretch is that box's
 * diagonal (as in reference_spline.h).
 *
 * Then halves, quarters, ... of the stretch are looked at from front to back, until one runs one way, or no iso-value
 * lies between its coefficients, which bound what it takes. Parts of a thousandth end that: what turns within so
 * little is near to rounding.
 */
#ifndef CELL_SPLINE_H
#define CELL_SPLINE_H

#include "features.h"
#include "lanes.h"
#include "sample_volume.h"
#include "scene.h"
#include "surface_levels.h"
#include "vectors.h"

#define DEGREE 9
#define WHOLE_STRETCH 1024 /* the stretch in parts of the smallest size: a power of two */
#define ROOT_SHARE 1e-6f   /* of a cell: to this roots are found */
#define ONE_WAY 1e-6f      /* of the largest coefficient: what turns back by less runs one way but for rounding */
/* of the voxels' span: as far the negative weights of Catmull and Rom's spline take it (1.25^3 / 2 - 1 / 2) */
#define OVERSHOOT 0.48f

__constant float spline_binomial_3[4] = {1.0f, 3.0f, 3.0f, 1.0f};
__constant float spline_binomial_9[DEGREE + 1] = {1.0f, 9.0f, 36.0f, 84.0f, 126.0f, 126.0f, 84.0f, 36.0f, 9.0f, 1.0f};

/* Exact at both ends: what two cells make of the face between them is the same, bit for bit. */
INLINE floatN mix_ends(floatN a, floatN b, floatN u) { return select(a + u * (b - a), b, MASK(u == 1.0f)); }

/* The 64 voxels that a cell uses, x fastest; beyond the volume the outermost ones count. `lowest`, `highest`: of them.
 * Gives the lanes in which all are finite. */
INLINE intN fetch_taps(__global const uchar *volume, __constant const View *view, intN ix, intN iy, intN iz,
                       floatN *tap, floatN *lowest,
                       floatN *highest)
{
  const intN zero = 0, one = 1;
  const intN first_x = MASK(ix == 0), last_x = MASK(ix == view->size.x - 2), first_y = MASK(iy == 0);
  const intN last_y = MASK(iy == view->size.y - 2);
  const intN first_z = MASK(iz == 0), last_z = MASK(iz == view->size.z - 2);
  const intN low_x = ix - select(one, zero, first_x), high_x = ix + select(one, zero, last_x);
  floatN sum = 0.0f;
  *lowest = INFINITY, *highest = -INFINITY;
  _Pragma("unroll 1") for (int block = 0; block < 4; ++block) {
    const int behind = block >> 1, below = block & 1;
    const intN y = below ? iy + select(one, zero, last_y) : iy - select(one, zero, first_y);
    const intN z = behind ? iz + select(one, zero, last_z) : iz - select(one, zero, first_z);
    const Corners a = decode_corners(fetch_corners(volume, view, low_x, y, z), view);
    const Corners b = decode_corners(fetch_corners(volume, view, high_x, y, z), view);
    const floatN a0[4] = {a.v000, a.v010, a.v001, a.v011}, a1[4] = {a.v100, a.v110, a.v101, a.v111};
    const floatN b0[4] = {b.v000, b.v010, b.v001, b.v011}, b1[4] = {b.v100, b.v110, b.v101, b.v111};
    /* Where a block moved inwards both of its rows or slices are the one within. */
    const intN same_y0 = below ? last_y : zero, same_y1 = below ? zero : first_y;
    const intN same_z0 = behind ? last_z : zero, same_z1 = behind ? zero : first_z;
    _Pragma("unroll 1") for (int row = 0; row < 4; ++row) {
      const intN to_y = row & 1 ? same_y1 : same_y0, to_z = row >> 1 ? same_z1 : same_z0;
      const int y_other = row ^ 1, z_other = row ^ 2, both = row ^ 3;
#define CHOSEN(v) select(select(v[row], v[y_other], to_y), select(v[z_other], v[both], to_y), to_z)
      const floatN p0 = CHOSEN(a0), inner0 = CHOSEN(a1), inner1 = CHOSEN(b0), p3 = CHOSEN(b1);
#undef CHOSEN
      const floatN p1 = select(inner0, p0, first_x), p2 = select(inner1, p3, last_x);
      floatN *to = tap + 16 * (2 * behind + (row >> 1)) + 4 * (2 * below + (row & 1));
      to[0] = p0, to[1] = p1, to[2] = p2, to[3] = p3;
      *lowest = lane_min(lane_min(lane_min(p0, p1), lane_min(p2, p3)), *lowest);
      *highest = lane_max(lane_max(lane_max(p0, p1), lane_max(p2, p3)), *highest);
      sum += (p0 - p0) + (p1 - p1) + (p2 - p2) + (p3 - p3);
    }
  }
  return finite_lanes(sum);
}

/* Replaces the four voxels c[0], c[stride], ... by the Bernstein coefficients of their cubic in the cell, from `low`
 * to `high` in it. */
INLINE void row_piece(floatN *c, int stride, floatN low, floatN high)
{
  const floatN p0 = c[0], p1 = c[stride], p2 = c[2 * stride], p3 = c[3 * stride];
#if FILTER == FILTER_CUBIC
  const floatN e0 = p1 + ((p0 - p1) + (p2 - p1)) * (1.0f / 6.0f), e3 = p2 + ((p1 - p2) + (p3 - p2)) * (1.0f / 6.0f);
  const floatN e1 = p1 + (p2 - p1) * (1.0f / 3.0f), e2 = p2 + (p1 - p2) * (1.0f / 3.0f);
#else
  const floatN e0 = p1, e1 = p1 + (p2 - p0) * (1.0f / 6.0f), e2 = p2 - (p3 - p1) * (1.0f / 6.0f), e3 = p2;
#endif
  const floatN l0 = mix_ends(e0, e1, low), l1 = mix_ends(e1, e2, low), l2 = mix_ends(e2, e3, low);
  const floatN h0 = mix_ends(e0, e1, high), h1 = mix_ends(e1, e2, high), h2 = mix_ends(e2, e3, high);
  const floatN ll0 = mix_ends(l0, l1, low), ll1 = mix_ends(l1, l2, low), hh0 = mix_ends(h0, h1, high);
  const floatN hh1 = mix_ends(h1, h2, high);
  c[0] = mix_ends(ll0, ll1, low), c[stride] = mix_ends(ll0, ll1, high);
  c[2 * stride] = mix_ends(hh0, hh1, low), c[3 * stride] = mix_ends(hh0, hh1, high);
}

#if VOXEL_HOLES
/* Where the stretch lies in a face of the cell what has no weight there does not count. */
INLINE void drop_unused(floatN *c, int stride, floatN low, floatN high)
{
  const intN at_low = MASK(low == 0.0f) & MASK(high == 0.0f), at_high = MASK(low == 1.0f) & MASK(high == 1.0f);
#if FILTER == FILTER_CUBIC
  c[3 * stride] = select(c[3 * stride], c[2 * stride], at_low), c[0] = select(c[0], c[stride], at_high);
#else
  const floatN p1 = c[stride], p2 = c[2 * stride];
  c[0] = select(select(c[0], p1, at_low), p2, at_high), c[stride] = select(p1, p2, at_high);
  c[2 * stride] = select(p2, p1, at_low), c[3 * stride] = select(select(c[3 * stride], p1, at_low), p2, at_high);
#endif
}
#endif

/* The ten coefficients of the stretch from the place `low` in the cell to `high`; `tap` is used up. */
INLINE void stretch_coefficients(floatN *tap, Vectors low, Vectors high, floatN *coefficient)
{
  _Pragma("unroll 1") for (int i = 0; i < 16; ++i) row_piece(tap + 4 * i, 1, low.x, high.x);
  _Pragma("unroll 1") for (int i = 0; i < 16; ++i) row_piece(tap + 16 * (i >> 2) + (i & 3), 4, low.y, high.y);
  _Pragma("unroll 1") for (int i = 0; i < 16; ++i) row_piece(tap + i, 16, low.z, high.z);
  const floatN base = tap[0];
  _Pragma("unroll 1") for (int m = 0; m <= DEGREE; ++m) coefficient[m] = 0.0f;
  _Pragma("unroll 1") for (int at = 0; at < 64; ++at) {
    const int i = at & 3, j = at >> 2 & 3, k = at >> 4;
    const float weight = spline_binomial_3[i] * spline_binomial_3[j] *
        spline_binomial_3[k] / spline_binomial_9[i + j + k];
    coefficient[i + j + k] += weight * (tap[at] - base);
  }
  _Pragma("unroll 1") for (int m = 0; m < DEGREE; ++m) coefficient[m] += base;
  coefficient[DEGREE] = tap[63];
}

/* The curve at w, and its slope (de Casteljau). */
INLINE floatN spline_at(const floatN *coefficient, floatN w, floatN *slope)
{
  floatN b[DEGREE + 1];
  _Pragma("unroll 1") for (int i = 0; i <= DEGREE; ++i) b[i] = coefficient[i];
  _Pragma("unroll 1") for (int n = DEGREE; n > 1; --n)
    _Pragma("unroll 1") for (int i = 0; i < n; ++i) b[i] += w * (b[i + 1] - b[i]);
  *slope = (float)DEGREE * (b[1] - b[0]);
  return select(b[0] + w * (b[1] - b[0]), coefficient[DEGREE], MASK(w == 1.0f));
}

/* The least and the largest coefficient of the part from a to b of the curve; gives the lanes in which it runs one
 * way. */
INLINE intN bound_part(const floatN *coefficient, floatN a, floatN b, floatN *lowest, floatN *highest)
{
  floatN c[DEGREE + 1];
  const floatN left = a / b;
  _Pragma("unroll 1") for (int i = 0; i <= DEGREE; ++i) c[i] = coefficient[i];
  _Pragma("unroll 1") for (int r = 1; r <= DEGREE; ++r)
    _Pragma("unroll 1") for (int i = DEGREE; i >= r; --i) c[i] = c[i - 1] + b * (c[i] - c[i - 1]);
  _Pragma("unroll 1") for (int r = 1; r <= DEGREE; ++r)
    _Pragma("unroll 1") for (int i = 0; i <= DEGREE - r; ++i) c[i] += left * (c[i + 1] - c[i]);
  floatN rise = 0.0f, fall = 0.0f;
  *lowest = c[0], *highest = c[0];
  _Pragma("unroll 1") for (int i = 1; i <= DEGREE; ++i) {
    *lowest = lane_min(*lowest, c[i]), *highest = lane_max(*highest, c[i]);
    rise = lane_max(rise, c[i] - c[i - 1]), fall = lane_max(fall, c[i - 1] - c[i]);
  }
  return MASK(lane_min(rise, fall) <= ONE_WAY * lane_max(fabs(*lowest), fabs(*highest)));
}

/* Where the curve takes the bracket's level: Newton's steps where they stay in the bracket, else halves of it. */
INLINE floatN spline_root(const floatN *coefficient, Bracket k, intN open)
{
  const intN rises = MASK(k.vb >= k.va);
  floatN w = k.a + (k.level - k.va) / select((floatN)1.0f, k.vb - k.va, open) * (k.b - k.a);
  _Pragma("unroll 1") for (int i = 0; i < 40 && any_lane(open); ++i) {
    floatN slope;
    const floatN miss = spline_at(coefficient, w, &slope) - k.level;
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

/* The first surface in the cell (ix, iy, iz), from `rank` of the part that begins at `piece` on. A cell that uses a
 * voxel that is not finite has none. */
INLINE CellHit look_in_cell(const Scene *scene, intN ix, intN iy, intN iz, Vectors low, Vectors high, intN piece,
                            intN rank, intN open)
{
  CellHit hit = no_hit();
  floatN tap[64], coefficient[DEGREE + 1], lowest, highest;
#if VOXEL_HOLES
  fetch_taps(scene->volume, scene->view, ix, iy, iz, tap, &lowest, &highest);
  lowest = INFINITY, highest = -INFINITY;
  floatN sum = 0.0f;
  _Pragma("unroll 1") for (int i = 0; i < 16; ++i) drop_unused(tap + 4 * i, 1, low.x, high.x);
  _Pragma("unroll 1") for (int i = 0; i < 16; ++i) drop_unused(tap + 16 * (i >> 2) + (i & 3), 4, low.y, high.y);
  _Pragma("unroll 1") for (int i = 0; i < 16; ++i) drop_unused(tap + i, 16, low.z, high.z);
  _Pragma("unroll 1") for (int i = 0; i < 64; ++i) {
    lowest = lane_min(tap[i], lowest), highest = lane_max(tap[i], highest);
    sum += tap[i] - tap[i];
  }
  open &= finite_lanes(sum);
#else
  fetch_taps(scene->volume, scene->view, ix, iy, iz, tap, &lowest, &highest);
#endif
#if FILTER == FILTER_CATMULL_ROM
  const floatN more = OVERSHOOT * (highest - lowest);
  lowest -= more, highest += more;
#endif
  open &= meets_a_surface(scene, lowest, highest);
  if (!any_lane(open)) return hit;
  stretch_coefficients(tap, low, high, coefficient);
  Bracket bracket = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
  /* The part begins at `at` and is `size` long; of those that begin there the largest comes first. */
  intN at = piece, size = select(at & -at, (intN)WHOLE_STRETCH, MASK(at == 0)), from = rank, left = open;
  floatN slope;
  for (;;) {
    left &= MASK(at < WHOLE_STRETCH);
    if (!any_lane(left)) break;
    const floatN a = TO_FLOAT(at) * (1.0f / WHOLE_STRETCH);
    const floatN b = TO_FLOAT(at + max(size, (intN)1)) * (1.0f / WHOLE_STRETCH);
    const intN one_way = bound_part(coefficient, a, b, &lowest, &highest) | MASK(size <= 1);
    const intN meets = left & meets_a_surface(scene, lowest, highest), asks = meets & one_way;
    if (any_lane(asks)) {
      const floatN va = spline_at(coefficient, a, &slope), vb = spline_at(coefficient, b, &slope);
      find_between(scene, at, a, b, va, vb, from, asks, &hit, &bracket);
      left &= ~hit.found;
    }
    const intN halves = meets & ~one_way, done = left & ~halves;
    size = select(size, size >> 1, halves);
    at = select(at, at + size, done), from = select(from, (intN)0, done);
    size = select(size, at & -at, done);
  }
  if (any_lane(hit.found)) hit.share = spline_root(coefficient, bracket, hit.found);
  return hit;
}

#endif
