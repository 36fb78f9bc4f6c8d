/* Columns of a tile, a pixel of the coarsest level wide, that sleep where nothing is visible.
 *
 * A map says how far it is from a place to anything visible (`free`, clvol/integrators/pyramid/caster.py), and outside
 * the volume the way to it adds up: squares of both, since the volume is convex. So there is a ball around each pixel
 * of the coarsest level in which nothing is to be seen. The rays of a column, and all that their values are made from,
 * stay inside its own pixel's ball and those of the eight around it for as many slices as the least of them reaches
 * beyond half the diagonal of a pixel. In these balls, which overlap, values lie in one interval in which nothing is
 * visible; so do means of them, and segments between them show exactly nothing. A column closes its segments on the
 * slice from where that is known, sleeps, and begins anew on a slice at which all pixels take part. Whether it sleeps
 * does not depend on the tile it is in.
 */
#ifndef PYRAMID_LEAP_H
#define PYRAMID_LEAP_H

#include "oracle.h"
#include "pyramid_levels.h"

#define LEAST_LEVEL 2 /* coarsest levels from which on columns are whole packets */

/* For how many slices from k on nothing is to be seen around each pixel of the coarsest level, if it `looks`. */
INLINE void find_free_slices(const Source *in, SHARED Levels *m, __global const uchar *free, int looks, int level,
                             int k)
{
  __constant const View *view = in->view;
  const int4 cells = in->pyramid->free_cells;
  const int side = side_of(level), width = WIDTH(level), patches = side / PACKET_W;
  const float half_diagonal = 0.7072f * ray_spacing(in, k) * (float)(1 << level), t = (float)k;
  /* A column is wider by so much an edge of its way. */
  const float grows = 0.7072f * in->pyramid->spacing_growth / view->step * (float)(1 << level);
  const float more = 1.0f + grows * grows;
  const floatN none = 0.0f;
  for (int p = WORKER; p < (looks ? patches * patches : 0); p += WORKERS) {
    const int row = p / patches * PACKET_H, column = p % patches * PACKET_W;
    const intN inside = MASK(column + (LANE_INDEX & (PACKET_W - 1)) < width) &
        MASK(row + LANE_INDEX / PACKET_W < width);
    floatN x, y, z;
    patch_places(m, level, p, t, &x, &y, &z);
    const floatN cx = lane_clamp(x, none, (floatN)view->upper.x), cy = lane_clamp(y, none, (floatN)view->upper.y);
    const floatN cz = lane_clamp(z, none, (floatN)view->upper.z);
    const floatN ex = (x - cx) * in->pyramid->edges.x, ey = (y - cy) * in->pyramid->edges.y;
    const floatN ez = (z - cz) * in->pyramid->edges.z;
    const floatN way = byte_distance(fetch_map_cell(free, cells, in->pyramid->free_shift, select(none, cx, inside),
                                                select(none, cy, inside), select(none, cz, inside)));
    /* Its corner is in the ball for w edges: w^2 + (half_diagonal + grows w)^2 = radius^2. */
    const floatN square = (way * way + ex * ex + ey * ey + ez * ez) * more - half_diagonal * half_diagonal;
    const floatN edges = (sqrt(lane_max(square, none)) - grows * half_diagonal) / more;
    const floatN slices = 0.98f / view->step * edges - 1.0f; /* but for rounding */
    store_patch(select((floatN)INFINITY, slices, inside), m->free_slices + row * side + column, side);
  }
  SYNCHRONISE();
}

/* What each column does in the chunk from `base` on: `slices` of it are 0 (it sleeps), 1 (it closes its segments and
 * goes to sleep), or all; and when it wakes. */
INLINE void send_to_sleep(const Source *in, SHARED Levels *m, __global const uchar *free, int base, int period)
{
  const int level = in->pyramid->levels + in->pyramid->oversampling;
  const int looks = base % period == 0 && level >= LEAST_LEVEL, side = side_of(level), row_of = TILE >> level;
  find_free_slices(in, m, free, looks, level, base);
  for (int c = WORKER; c < (level >= LEAST_LEVEL ? row_of * row_of : 0); c += WORKERS) {
    int slices = m->wakes[c] > base ? 0 : CHUNK;
    if (slices && looks) {
      SHARED const float *around = m->free_slices + c / row_of * side + c % row_of;
      float least = 1e6f;
      for (int j = 0; j < 9; ++j) least = fmin(least, around[j / 3 * side + j % 3]);
      const int wakes = (base + (int)fmax(least, 0.0f)) / period * period;
      if (wakes >= base + 2 * period) slices = 1, m->wakes[c] = wakes;
    }
    m->slices[c] = slices;
  }
  SYNCHRONISE();
}

#endif
