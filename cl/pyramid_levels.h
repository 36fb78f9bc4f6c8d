/* The levels above 0 of a tile: which of their pixels take part on a slice, and what they become (cl/pyramid.h). */
#ifndef PYRAMID_LEVELS_H
#define PYRAMID_LEVELS_H

#include "pyramid_rays.h"

#if LANES == 16
/* 4 by 4 of an array whose rows are `side` apart. */
INLINE floatN load_patch(SHARED const float *a, int side)
{
  return (float16)(vload4(0, a), vload4(0, a + side), vload4(0, a + 2 * side), vload4(0, a + 3 * side));
}
INLINE void store_patch(floatN v, SHARED float *a, int side)
{
  vstore4(v.s0123, 0, a), vstore4(v.s4567, 0, a + side), vstore4(v.s89ab, 0, a + 2 * side), vstore4(v.scdef, 0, a + 3 * side);
}
#else
INLINE floatN load_patch(SHARED const float *a, int side) { return a[0]; }
INLINE void store_patch(floatN v, SHARED float *a, int side) { a[0] = v; }
#endif

/* Synthesis (P1 fig. 5 to 7) of the patch at (column, row) of a level, from the next one, whose rows are `side` apart. A pixel between
 * two others a quarter of their distance from the nearer one: that one has 3/4 of the weight along this axis. Weights count from the
 * nearer one, so equal values give exactly that value. Columns and rows count from the pixel around the tile; those of level 0, which
 * has none there, from one more (`from`). */
#if LANES == 16
/* Of a patch of level 1 and above. */
INLINE floatN synthesised(SHARED const float *up, int side, int column, int row)
{
  const float16 c = load_patch(up + (row >> 1) * side + (column >> 1), side);
  const float16 x0 = c.s001144558899ccdd, x1 = c.s1122556699aaddee;
  const float16 near_x = (float16)(0.25f, 0.75f, 0.25f, 0.75f, 0.25f, 0.75f, 0.25f, 0.75f, 0.25f, 0.75f, 0.25f, 0.75f, 0.25f, 0.75f,
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
  const float16 near_x = (float16)(0.75f, 0.25f, 0.75f, 0.25f, 0.75f, 0.25f, 0.75f, 0.25f, 0.75f, 0.25f, 0.75f, 0.25f, 0.75f, 0.25f,
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

/* Rays of all pixels of levels 1 to `levels`, of the tile whose first pixel is (left, top); none of them has a distance yet. */
INLINE void prepare_levels(__constant const View *view, SHARED Levels *m, int levels, int left, int top)
{
  for (int level = 1, at = 0; level <= levels; at += side_of(level) * side_of(level), ++level) {
    const int side = side_of(level), patches = side / PACKET_W;
    const float scale = (float)(1 << level), first = 0.5f * scale - 0.5f - scale; /* of the pixel around the tile */
    for (int p = WORKER; p < patches * patches; p += WORKERS) {
      const int row = p / patches * PACKET_H, column = p % patches * PACKET_W, to = at + row * side + column;
      const floatN x = TO_FLOAT(column + (LANE_INDEX & (PACKET_W - 1))), y = TO_FLOAT(row + LANE_INDEX / PACKET_W);
      const SliceRays r = slice_rays(view, (float)left + first + scale * x, (float)top + first + scale * y, 0);
      store_patch(r.x0, m->x0 + to, side), store_patch(r.y0, m->y0 + to, side), store_patch(r.z0, m->z0 + to, side);
      store_patch(r.dx, m->dx + to, side), store_patch(r.dy, m->dy + to, side), store_patch(r.dz, m->dz + to, side);
      store_patch((floatN)0.0f, m->distance + to, side), store_patch((floatN)0.0f, m->value + to, side);
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
  if (along == in->pyramid->levels.x) return INFINITY;
  return (float)(2 << along) * in->view->march.x + SLACK * ray_spacing(in, k) * (float)(1 << level);
}

/* Pixels of a level whose place is not so far outside the volume that no pixel of the picture is made from it. */
INLINE intN near_volume(const Source *in, floatN x, floatN y, floatN z, float spacing)
{
  const float4 upper = in->view->upper, edges = in->pyramid->edges;
  const floatN zero = 0.0f;
  const floatN ex = (x - lane_clamp(x, zero, (floatN)upper.x)) * edges.x, ey = (y - lane_clamp(y, zero, (floatN)upper.y)) * edges.y;
  const floatN ez = (z - lane_clamp(z, zero, (floatN)upper.z)) * edges.z;
  /* Pixels made from this one are up to twice its spacing away along both axes; and they take part a period before and behind. */
  const float reach = 2.9f * spacing + (float)max(CHUNK, 1 << in->pyramid->levels.x) * in->view->march.x;
  return MASK(ex * ex + ey * ey + ez * ez <= reach * reach);
}

/* The pixels `lanes` of the patch at `at` of a level, and their places. */
INLINE FetchedPlace fetch_pixels(const Source *in, SHARED const Levels *m, int level, int at, uint lanes, float t, floatN *x, floatN *y, floatN *z)
{
  const int side = side_of(level), from = offset_of(level) + at;
  *x = load_patch(m->x0 + from, side) + t * load_patch(m->dx + from, side);
  *y = load_patch(m->y0 + from, side) + t * load_patch(m->dy + from, side);
  *z = load_patch(m->z0 + from, side) + t * load_patch(m->dz + from, side);
  return fetch_place(in, *x, *y, *z, lanes_of(lanes));
}

/* One level on slice k; `up`: the next level, NULL for the highest that takes part. What does not take part goes over from `old` to
 * `now`. `changes`: whether any pixel may. `well_inside`: all of the tile is inside the volume. First it is found which pixels are to be sampled, then they are, each patch
 * fetched while the one before is looked at. */
void update_level(const Source *in, SHARED Levels *m, int changes, int level, int k, int along, int well_inside, SHARED const float *old_distance,
                  SHARED const float *old_value, SHARED float *distances, SHARED float *values, SHARED const float *up_distance,
                  SHARED const float *up_value, Tally *samples, Tally *counted)
{
  const int side = side_of(level), side_up = side_of(level + 1), width = WIDTH(level), patches = side / PACKET_W;
  const int all = changes ? patches * patches : 0;
  const float spacing = ray_spacing(in, k) * (float)(1 << level), dense = WITHIN * spacing, reach = reach_of(in, level, k, along), t = (float)k;
  const floatN never = INFINITY;
  floatN nearest = never;
  int first = -1; /* of this work-item's patches to sample */
  for (int p = WORKER; p < all; p += WORKERS) {
    const int row = p / patches * PACKET_H, column = p % patches * PACKET_W, at = row * side + column;
    floatN distance = load_patch(old_distance + at, side);
    const intN inside = MASK(column + (LANE_INDEX & (PACKET_W - 1)) < width) & MASK(row + LANE_INDEX / PACKET_W < width);
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
    const uint bits = lane_bits(sampled);
    m->sampled[p] = bits;
    first = first < 0 && bits ? p : first;
    nearest = lane_min(nearest, select(never, distance, inside & ~sampled));
  }
  if (first >= 0) {
    floatN next_x, next_y, next_z;
    FetchedPlace next = fetch_pixels(in, m, level, first / patches * PACKET_H * side + first % patches * PACKET_W, m->sampled[first], t, &next_x, &next_y, &next_z);
    for (int p = first; p < all;) {
      const FetchedPlace fetched = next;
      const floatN x = next_x, y = next_y, z = next_z;
      const int at = p / patches * PACKET_H * side + p % patches * PACKET_W;
      intN sampled = lanes_of(m->sampled[p]);
      for (p += WORKERS; p < all && !m->sampled[p]; p += WORKERS);
      if (p < all)
        next = fetch_pixels(in, m, level, p / patches * PACKET_H * side + p % patches * PACKET_W, m->sampled[p], t, &next_x, &next_y, &next_z);
      if (!well_inside) sampled &= near_volume(in, x, y, z, spacing);
      const floatN value = select(load_patch(values + at, side), place_value(in, &fetched), sampled);
      const floatN distance = select(load_patch(distances + at, side), place_distance(in, &fetched, x, y, z, value, (floatN)1.0f), sampled);
      store_patch(distance, distances + at, side), store_patch(value, values + at, side);
      nearest = lane_min(nearest, select(never, distance, sampled));
      count_lanes(samples, sampled), count_lanes(&counted[COUNT_ORACLE], sampled);
    }
  }
  float each[LANES], least = INFINITY;
  STORE_LANES(nearest, each);
  EACH_LANE(j) least = fmin(least, each[j]);
  least = group_min(m, least);
  if (WORKER == 0 && changes) m->nearest[level] = least;
  SYNCHRONISE();
}

/* All levels above 0 on slice k, the i-th of its chunk. Work-items that share a tile all come to the same barriers, whatever there is to do:
 * not all compilers get barriers under conditions right. */
INLINE void update_levels(const Source *in, SHARED Levels *m, int k, int i, int is_awake, int well_inside, Tally *samples, Tally *counted)
{
  const int along = slice_level(in, k), top = along + in->pyramid->levels.y, copy = m->last_copy;
  int changes = 0;
  for (int level = WORKERS == 1 ? top : MOST_LEVELS; level > 0; --level) {
    const int changes_here = is_awake && level <= top && m->nearest[level] < reach_of(in, level, k, along);
    if (WORKERS == 1 && !changes_here) continue;
    const int at = offset_of(level), up = offset_of(level + 1), synthesises = level < top, is_first = level == 1;
    update_level(in, m, changes_here, level, k, along, well_inside, is_first ? m->distance1[copy] : m->distance + at,
                 is_first ? m->value1[copy] : m->value + at, is_first ? m->distance1[i] : m->distance + at,
                 is_first ? m->value1[i] : m->value + at, synthesises ? m->distance + up : 0, synthesises ? m->value + up : 0, samples, counted);
    if (is_first) changes = changes_here;
  }
  if (WORKER == 0) {
    if (changes) m->last_copy = i;
    m->copy[i] = changes ? i : copy;
  }
  SYNCHRONISE();
}

#endif
