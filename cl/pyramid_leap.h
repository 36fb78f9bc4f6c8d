/* Leaps of a whole tile over empty space (skip_empty.h has the map).
 *
 * Nothing is visible within a radius of each pixel of the coarsest level, by the distance of its cell, or, outside the volume, by the
 * way to it: the volume is convex, so that both squares add up. All of a tile's rays stay inside these balls for as many slices as
 * the least of them reaches beyond half the pixels' diagonal. Values there lie in one interval in which nothing is visible, since
 * neighbouring balls overlap; so do means of them, and segments between them show exactly nothing. A leap ends one longest segment
 * before the free slices do: the first visible segment has the sample before it, as it would without the leap, and the picture
 * does not change by a bit.
 */
#ifndef PYRAMID_LEAP_H
#define PYRAMID_LEAP_H

#include "pyramid_levels.h"

/* How many slices from k on nothing of the tile can be visible. */
INLINE float free_slices(const Source *in, SHARED Levels *m, __global const uchar *distances, int k)
{
  __constant const View *view = in->view;
  const int level = in->pyramid->levels.x + in->pyramid->levels.y;
  if (level < 1) return 0.0f;
  const int side = side_of(level), width = WIDTH(level), patches = side / PACKET_W, at = offset_of(level);
  const float half_diagonal = 0.7072f * ray_spacing(in, k) * (float)(1 << level);
  const intN zero = 0, last_x = view->cells.x - 1, last_y = view->cells.y - 1, last_z = view->cells.z - 1;
  floatN least = INFINITY;
  for (int p = WORKER; p < patches * patches; p += WORKERS) {
    const int row = p / patches * PACKET_H, column = p % patches * PACKET_W, from = at + row * side + column;
    const intN inside = MASK(column + (LANE_INDEX & (PACKET_W - 1)) < width) & MASK(row + LANE_INDEX / PACKET_W < width);
    const floatN t = (float)k, none = 0.0f;
    const floatN x = load_patch(m->x0 + from, side) + t * load_patch(m->dx + from, side);
    const floatN y = load_patch(m->y0 + from, side) + t * load_patch(m->dy + from, side);
    const floatN z = load_patch(m->z0 + from, side) + t * load_patch(m->dz + from, side);
    const floatN cx = lane_clamp(x, none, (floatN)view->upper.x), cy = lane_clamp(y, none, (floatN)view->upper.y);
    const floatN cz = lane_clamp(z, none, (floatN)view->upper.z);
    const intN cell = (min(TO_INT(cz) >> view->cells.w, last_z) * view->cells.y + min(TO_INT(cy) >> view->cells.w, last_y)) * view->cells.x +
                      min(TO_INT(cx) >> view->cells.w, last_x);
    const intN cells = max(AS_INT(gather1(distances, cell) & 255u) - 1, zero) << view->cells.w; /* lattice units are an edge or longer */
    const floatN ex = (x - cx) * in->pyramid->edges.x, ey = (y - cy) * in->pyramid->edges.y, ez = (z - cz) * in->pyramid->edges.z;
    const floatN radius = TO_FLOAT(cells);
    const floatN square = radius * radius + ex * ex + ey * ey + ez * ez;
    least = lane_min(least, select((floatN)INFINITY, square, inside));
  }
  float each[LANES], square = INFINITY;
  STORE_LANES(least, each);
  EACH_LANE(j) square = fmin(square, each[j]);
  square = group_min(m, square);
  const float across = half_diagonal * half_diagonal;
  /* Not to the last digit: rounding of places, and of rays that grow apart on the way. */
  return square > across ? 0.98f * sqrt(square - across) / view->march.x - 1.0f : 0.0f;
}

#endif
