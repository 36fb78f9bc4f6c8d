/* The levels above 0 of a tile: which of their pixels take part on a slice, and what they become (cl/pyramid.h). */
#ifndef PYRAMID_LEVELS_H
#define PYRAMID_LEVELS_H

#include "lanes.h"
#include "pyramid_places.h"
#include "pyramid_rays.h"
#include "tally.h"
#include "view.h"

#if LANES == 16
/* 4 by 4 of an array whose rows are `side` apart. */
INLINE floatN load_patch(SHARED const float *a, int side)
{
  return (float16)(vload4(0, a), vload4(0, a + side), vload4(0, a + 2 * side), vload4(0, a + 3 * side));
}
INLINE void store_patch(floatN v, SHARED float *a, int side)
{
  vstore4(v.s0123, 0, a), vstore4(v.s4567, 0, a + side), vstore4(v.s89ab, 0, a + 2 * side),
      vstore4(v.scdef, 0, a + 3 * side);
}
#else
INLINE floatN load_patch(SHARED const float *a, int side) { return a[0]; }
INLINE void store_patch(floatN v, SHARED float *a, int side) { a[0] = v; }
#endif

/* Synthesis (Kraus et al. 2007, figs. 5 to 7) of the patch at (column, row) of a level, from the next one, whose rows
 * are `side` apart. A pixel between two others a quarter of their distance from the nearer one: that one has 3/4 of
 * the weight along this axis. Weights count from the nearer one, so equal values give exactly that value. Columns and
 * rows count from the pixel around the tile; those of level 0, which has none there, from one more (`from`). */
#if LANES == 16
/* Of a patch of level 1 and above. */
INLINE floatN synthesised(SHARED const float *up, int side, int column, int row)
{
  const float16 c = load_patch(up + (row >> 1) * side + (column >> 1), side);
  const float16 x0 = c.s001144558899ccdd, x1 = c.s1122556699aaddee;
  const float16 near_x = (float16)(0.25f, 0.75f, 0.25f, 0.75f, 0.25f, 0.75f, 0.25f, 0.75f, 0.25f, 0.75f, 0.25f, 0.75f,
                                   0.25f, 0.75f,
                                   0.25f, 0.75f);
  const float16 near_y = (float16)((float4)0.25f, (float4)0.75f, (float4)0.25f, (float4)0.75f);
  const float16 x = x0 + near_x * (x1 - x0);
  const float16 y0 = x.s0123012345674567, y1 = x.s4567456789ab89ab;
  return y0 + near_y * (y1 - y0);
}
/* Of a patch of level 0. */
INLINE floatN synthesised_pixels(SHARED const float *up, int side, int column, int row)
{
  const float16 c = load_patch(up + (row >> 1) * side + (column >> 1), side);
  const float16 x0 = c.s01124556899acdde, x1 = c.s122356679aabdeef;
  const float16 near_x = (float16)(0.75f, 0.25f, 0.75f, 0.25f, 0.75f, 0.25f, 0.75f, 0.25f, 0.75f, 0.25f, 0.75f, 0.25f,
                                   0.75f, 0.25f,
                                   0.75f, 0.25f);
  const float16 near_y = (float16)((float4)0.75f, (float4)0.25f, (float4)0.75f, (float4)0.25f);
  const float16 x = x0 + near_x * (x1 - x0);
  const float16 y0 = x.s01234567456789ab, y1 = x.s456789ab89abcdef;
  return y0 + near_y * (y1 - y0);
}
#else
INLINE floatN synthesised(SHARED const float *up, int side, int column, int row)
{
  SHARED const float *c = up + (row >> 1) * side + (column >> 1);
  const float x = column & 1 ? 0.75f : 0.25f, y = row & 1 ? 0.75f : 0.25f;
  const float low = c[0] + x * (c[1] - c[0]), high = c[side] + x * (c[side + 1] - c[side]);
  return low + y * (high - low);
}
INLINE floatN synthesised_pixels(SHARED const float *up, int side, int column, int row)
{
  return synthesised(up, side, column + 1, row + 1);
}
#endif

/* Rays of all pixels of levels 1 to `levels`, of the tile whose first pixel is (left, top); none of them has a
 * distance yet. */
INLINE void prepare_levels(__constant const View *view, SHARED Levels *m, int levels, int left, int top)
{
  for (int level = 1, at = 0; level <= levels; at += side_of(level) * side_of(level), ++level) {
    const int side = side_of(level), patches = side / PACKET_W;
    const floatN none = 0.0f;
    const float scale = (float)(1 << level), first = 0.5f * scale - 0.5f - scale; /* of the pixel around the tile */
    for (int p = WORKER; p < patches * patches; p += WORKERS) {
      const int row = p / patches * PACKET_H, column = p % patches * PACKET_W, to = at + p * LANES;
      const floatN x = TO_FLOAT(column + (LANE_INDEX & (PACKET_W - 1))), y = TO_FLOAT(row + LANE_INDEX / PACKET_W);
      const SliceRays r = slice_rays(view, (float)left + first + scale * x, (float)top + first + scale * y, 0);
      STORE_LANES(r.x0, m->x0 + to), STORE_LANES(r.y0, m->y0 + to), STORE_LANES(r.z0, m->z0 + to);
      STORE_LANES(r.dx, m->dx + to), STORE_LANES(r.dy, m->dy + to), STORE_LANES(r.dz, m->dz + to);
      STORE_LANES(none, m->distance + to), STORE_LANES(none, m->value + to);
    }
  }
  for (int p = WORKER; p < AREA(1) + SIDE(1); p += WORKERS) m->distance1[CHUNK - 1][p] = m->value1[CHUNK - 1][p] = 0.0f;
  for (int c = WORKER; c < COLUMNS; c += WORKERS) m->wakes[c] = 0, m->slices[c] = CHUNK;
  if (WORKER == 0) {
    m->last_copy = CHUNK - 1;
    for (int level = 0; level <= MOST_LEVELS; ++level) m->nearest[level] = 0.0f;
  }
  SYNCHRONISE();
}

/* How far a pixel of a level may look that takes part on a slice: slice_level(k) is `along`. */
INLINE float reach_of(const Source *in, int level, int k, int along)
{
  if (along == in->pyramid->levels) return INFINITY;
  return (float)(2 << along) * in->view->step + SLACK * ray_spacing(in, k) * (float)(1 << level);
}

/* Pixels of a level whose place is not so far outside the volume that no pixel of the picture is made from it. */
INLINE intN near_volume(const Source *in, floatN x, floatN y, floatN z, float spacing)
{
  const float4 upper = in->view->upper, edges = in->pyramid->edges;
  const floatN zero = 0.0f;
  const floatN ex = (x - lane_clamp(x, zero, (floatN)upper.x)) * edges.x;
  const floatN ey = (y - lane_clamp(y, zero, (floatN)upper.y)) * edges.y;
  const floatN ez = (z - lane_clamp(z, zero, (floatN)upper.z)) * edges.z;
  /* Pixels made from this one are up to twice its spacing away along both axes; and they take part a period before and
   * behind. */
  const float reach = 2.9f * spacing + (float)max(CHUNK, 1 << in->pyramid->levels) * in->view->step;
  return MASK(ex * ex + ey * ey + ez * ez <= reach * reach);
}

/* Where in its level's arrays a patch begins. */
INLINE int patch_at(int patch, int patches,
                    int side) { return patch / patches * PACKET_H * side + patch % patches * PACKET_W; }

/* Places on slice `t` of a patch of a level. */
INLINE void patch_places(SHARED const Levels *m, int level, int patch, float t, floatN *x, floatN *y, floatN *z)
{
  const int from = offset_of(level) + patch * LANES;
  *x = LOAD_LANES(m->x0 + from) + t * LOAD_LANES(m->dx + from);
  *y = LOAD_LANES(m->y0 + from) + t * LOAD_LANES(m->dy + from);
  *z = LOAD_LANES(m->z0 + from) + t * LOAD_LANES(m->dz + from);
}

/* The largest of 3 by 3 distances around each pixel of the patch at (column, row); what is not there does not count. */
#if LANES == 16
INLINE float4 largest_in_row(SHARED const float *a, int column, int side)
{
  const float4 here = vload4(0, a);
  const float4 before = column > 0 ? vload4(0, a - 1) : here.s0012;
  const float4 behind = column + 4 < side ? vload4(0, a + 1) : here.s1233;
  return fmax(fmax(before, behind), here);
}
INLINE floatN largest_around(SHARED const float *distances, int column, int row, int side)
{
  SHARED const float *a = distances + row * side + column;
  const float4 r1 = largest_in_row(a, column, side), r2 = largest_in_row(a + side, column, side);
  const float4 r3 = largest_in_row(a + 2 * side, column, side), r4 = largest_in_row(a + 3 * side, column, side);
  const float4 r0 = row > 0 ? largest_in_row(a - side, column, side) : r1;
  const float4 r5 = row + 4 < side ? largest_in_row(a + 4 * side, column, side) : r4;
  const float4 r12 = fmax(r1, r2), r34 = fmax(r3, r4);
  return (float16)(fmax(r0, r12), fmax(r12, r3), fmax(r2, r34), fmax(r34, r5));
}
#else
INLINE floatN largest_around(SHARED const float *distances, int column, int row, int side)
{
  float largest = 0.0f;
  for (int y = max(row - 1, 0); y <= min(row + 1, side - 1); ++y)
    for (int x = max(column - 1, 0); x <= min(column + 1, side - 1); ++x) largest = fmax(largest,
        distances[y * side + x]);
  return largest;
}
#endif

/* The pixels of a level, out of those to be sampled, whose value is needed, once the oracle has been asked: all but
 * those from which nothing is synthesised now, since all pixels that would be are sampled, nor before they are sampled
 * again: they are, whenever their level takes part. */
INLINE intN needs_value(const Source *in, SHARED const float *distances, int level, int column, int row, int k)
{
  const int side = side_of(level), most = in->pyramid->levels, more = in->pyramid->oversampling;
  const float spacing = ray_spacing(in, k) * (float)(1 << level);
  const floatN own = load_patch(distances + row * side + column, side);
  /* Just less than the next level's bound: means of distances may be rounded up. */
  return MASK(largest_around(distances, column, row, side) >= 0.499f * WITHIN * spacing) |
         MASK(own >= reach_of(in, level, k, max(level - more, 0)));
}

/* This work-item's next patch to sample after `p`, of `all`. */
INLINE int next_patch(SHARED const Levels *m, int p, int all)
{
  for (p += WORKERS; p < all && !m->sampled[p]; p += WORKERS);
  return p;
}

/* One level on slice k; `up`: the next level, NULL for the highest that takes part. What does not take part goes over
 * from `old` to `now`. `changes`: whether any pixel may. `well_inside`: all rays of the tile that meet the volume are
 * inside. First it is found which pixels are to be sampled; then the oracle is asked; then, for those whose value is
 * needed, the volume is, each patch fetched while the one before is looked at. An oracle that needs to know the value
 * is asked last. */
void update_level(const Source *in, SHARED Levels *m, int changes, int level, int k, int along, int well_inside,
                  SHARED const float *old_distance, SHARED const float *old_value, SHARED float *distances,
                      SHARED float *values,
                  SHARED const float *up_distance, SHARED const float *up_value, Tally *samples, Tally *counted)
{
  const int side = side_of(level), side_up = side_of(level + 1), width = WIDTH(level), patches = side / PACKET_W;
  const int all = changes ? patches * patches : 0;
  const float spacing = ray_spacing(in, k) * (float)(1 << level), dense = WITHIN * spacing, t = (float)k;
  const float reach = reach_of(in, level, k, along);
  const floatN never = INFINITY;
  floatN nearest = never, x, y, z;
  int first = all; /* of this work-item's patches to sample */
  for (int p = WORKER; p < all; p += WORKERS) {
    const int row = p / patches * PACKET_H, column = p % patches * PACKET_W, at = row * side + column;
    floatN distance = load_patch(old_distance + at, side);
    const intN inside = MASK(column + (LANE_INDEX & (PACKET_W - 1)) < width) &
        MASK(row + LANE_INDEX / PACKET_W < width);
    const intN takes_part = inside & MASK(distance < reach);
    intN sampled = takes_part;
    if (any_lane(takes_part)) {
      floatN value = load_patch(old_value + at, side);
      if (up_value) {
        distance = select(distance, synthesised(up_distance, side_up, column, row), takes_part);
        value = select(value, synthesised(up_value, side_up, column, row), takes_part);
        sampled &= MASK(distance < dense)
#if VOXEL_HOLES
                   | ~finite_lanes(value)
#endif
          ;
        count_lanes(&counted[COUNT_SYNTHESES], takes_part);
      }
      store_patch(distance, distances + at, side), store_patch(value, values + at, side);
    } else if (distances != old_distance)
      store_patch(distance, distances + at, side), store_patch(load_patch(old_value + at, side), values + at, side);
    if (!well_inside && any_lane(sampled)) {
      patch_places(m, level, p, t, &x, &y, &z);
      sampled &= near_volume(in, x, y, z, spacing);
    }
    const uint bits = lane_bits(sampled);
    m->sampled[p] = bits;
    if (bits) first = min(first, p);
    nearest = lane_min(nearest, select(never, distance, inside & ~sampled));
  }
  floatN next_x, next_y, next_z;
#if !ORACLE_NEEDS_VALUE
  intN next_byte;
  if (first < all) {
    patch_places(m, level, first, t, &next_x, &next_y, &next_z);
    next_byte = ORACLE_HAS_MAP ? fetch_map(in, next_x, next_y, next_z) : (intN)0;
  }
  for (int p = first; p < all;) {
    const int at = patch_at(p, patches, side);
    const intN sampled = lanes_of(m->sampled[p]), byte = next_byte;
    x = next_x, y = next_y, z = next_z;
    p = next_patch(m, p, all);
    if (p < all) {
      patch_places(m, level, p, t, &next_x, &next_y, &next_z);
      next_byte = ORACLE_HAS_MAP ? fetch_map(in, next_x, next_y, next_z) : (intN)0;
    }
    const floatN wanted = asked_distance(in, x, y, z, (floatN)0.0f, byte, (floatN)1.0f);
    const floatN distance = select(load_patch(distances + at, side), wanted, sampled);
    store_patch(distance, distances + at, side);
    nearest = lane_min(nearest, select(never, distance, sampled));
    count_lanes(&counted[COUNT_ORACLE_SAMPLES], sampled);
  }
  SYNCHRONISE();
  const int from = first;
  first = all;
  for (int p = from; p < all; p = next_patch(m, p, all)) {
    m->sampled[p] &= lane_bits(needs_value(in, distances, level, p % patches * PACKET_W, p / patches * PACKET_H, k));
    if (m->sampled[p]) first = min(first, p);
  }
#endif
  if (first < all) {
    patch_places(m, level, first, t, &next_x, &next_y, &next_z);
    FetchedPlace next = fetch_place(in, next_x, next_y, next_z, lanes_of(m->sampled[first]), ORACLE_NEEDS_VALUE);
    for (int p = first; p < all;) {
      const FetchedPlace fetched = next;
      const int at = patch_at(p, patches, side);
      const intN sampled = lanes_of(m->sampled[p]);
      x = next_x, y = next_y, z = next_z;
      p = next_patch(m, p, all);
      if (p < all) {
        patch_places(m, level, p, t, &next_x, &next_y, &next_z);
        next = fetch_place(in, next_x, next_y, next_z, lanes_of(m->sampled[p]), ORACLE_NEEDS_VALUE);
      }
      const floatN value = select(load_patch(values + at, side), place_value(in, &fetched), sampled);
      store_patch(value, values + at, side);
      count_lanes(samples, sampled);
#if ORACLE_NEEDS_VALUE
      const floatN distance = select(load_patch(distances + at, side),
                                     place_distance(in, &fetched, x, y, z, value, (floatN)1.0f), sampled);
      store_patch(distance, distances + at, side);
      nearest = lane_min(nearest, select(never, distance, sampled));
      count_lanes(&counted[COUNT_ORACLE_SAMPLES], sampled);
#endif
    }
  }
  float each[LANES], least = INFINITY;
  STORE_LANES(nearest, each);
  EACH_LANE(j) least = fmin(least, each[j]);
  least = group_min(m, least);
  if (WORKER == 0 && changes) m->nearest[level] = least;
  SYNCHRONISE();
}

/* All levels above 0 on slice k, the i-th of its chunk. Work-items that share a tile all come to the same barriers,
 * whatever there is to do: not all compilers get barriers under conditions right. */
INLINE void update_levels(const Source *in, SHARED Levels *m, int k, int i, int is_awake, int well_inside,
                          Tally *samples, Tally *counted)
{
  const int along = slice_level(in, k), top = along + in->pyramid->oversampling, copy = m->last_copy;
  int changes = 0;
  for (int level = WORKERS == 1 ? top : MOST_LEVELS; level > 0; --level) {
    const int changes_here = is_awake && level <= top && m->nearest[level] < reach_of(in, level, k, along);
    if (WORKERS == 1 && !changes_here) continue;
    const int at = offset_of(level), up = offset_of(level + 1), synthesises = level < top, is_first = level == 1;
    update_level(in, m, changes_here, level, k, along, well_inside, is_first ? m->distance1[copy] : m->distance + at,
                 is_first ? m->value1[copy] : m->value + at, is_first ? m->distance1[i] : m->distance + at,
                 is_first ? m->value1[i] : m->value + at, synthesises ? m->distance + up : 0,
                     synthesises ? m->value + up : 0, samples, counted);
    if (is_first) changes = changes_here;
  }
  if (WORKER == 0) {
    if (changes) m->last_copy = i;
    m->copy[i] = changes ? i : copy;
  }
  SYNCHRONISE();
}

#endif
