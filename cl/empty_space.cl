/* The acceleration structure for empty space: a min-max grid of the volume (built once), the cells in which the
 * transfer function shows anything (once a transfer function, on the host: a few thousand cells), and the distance map
 * from them.
 *
 * Switches (-D): VOXEL_BITS, VOXEL_SIGNED.
 */
#include "voxel_type.h"

#if VOXEL_BITS >= 32
#define LOW_OF(v) (isfinite(v) ? (v) : (Voxel)INFINITY)
#define HIGH_OF(v) (isfinite(v) ? (v) : -(Voxel)INFINITY)
#else
#define LOW_OF(v) (v)
#define HIGH_OF(v) (v)
#endif
#define COLUMNS 256 /* voxels of a row that are looked at together, the aprons of the cells at both ends included */

/* Smallest and largest finite voxel of each cell of edge^3 lattice cells, its upper faces and `apron` voxels more on
 * each side included (0: (edge + 1)^3 voxels): whatever a filter that reaches so far interpolates inside lies between.
 * A cell without any has low > high. A work-item (y, z) finds those of a row of cells: first of columns of voxels, which
 * compilers make vectors of. edge + 2 apron is less than COLUMNS.
 *
 * volume  Voxel [size.z, size.y, size.x]; cells Voxel [cells.z, cells.y, cells.x, 2] (low, high)
 */
__kernel void min_max_cells(__global const Voxel *restrict volume, int4 size, int edge, int apron, int cells_x,
                            __global Voxel *restrict cells)
{
  const int cy = get_global_id(0), cz = get_global_id(1);
  const int y0 = max(cy * edge - apron, 0), y1 = min((cy + 1) * edge + apron, size.y - 1);
  const int z0 = max(cz * edge - apron, 0), z1 = min((cz + 1) * edge + apron, size.z - 1);
  __global Voxel *out = cells + 2 * ((size_t)cz * get_global_size(0) + cy) * cells_x;
  const int together = max((COLUMNS - 1 - 2 * apron) / edge, 1);
  Voxel low[COLUMNS], high[COLUMNS];
  for (int first = 0; first < cells_x; first += together) {
    const int end = min(first + together, cells_x);
    const int x0 = max(first * edge - apron, 0), count = min(end * edge + apron, size.x - 1) - x0 + 1;
    for (int z = z0; z <= z1; ++z)
      for (int y = y0; y <= y1; ++y) {
        __global const Voxel *row = volume + ((size_t)z * size.y + y) * size.x + x0;
        if (z == z0 && y == y0)
          for (int x = 0; x < count; ++x) low[x] = LOW_OF(row[x]), high[x] = HIGH_OF(row[x]);
        else
          for (int x = 0; x < count; ++x) {
            const Voxel a = LOW_OF(row[x]), b = HIGH_OF(row[x]);
            low[x] = a < low[x] ? a : low[x], high[x] = b > high[x] ? b : high[x];
          }
      }
    for (int cx = first; cx < end; ++cx) {
      const int from = max(cx * edge - apron, 0) - x0, to = min((cx + 1) * edge + apron, size.x - 1) - x0;
      Voxel least = low[from], most = high[from];
      for (int x = from + 1; x <= to; ++x)
        least = low[x] < least ? low[x] : least, most = high[x] > most ? high[x] : most;
      const int any_value = least <= most;
      out[2 * cx] = any_value ? least : (Voxel)1, out[2 * cx + 1] = any_value ? most : (Voxel)0;
    }
  }
}

/* One of three passes of the distance transform in the maximum norm, along the axis whose neighbours are `stride`
 * apart: out = min over k of max(|k|, in[cell + k]). 0 stays 0, and 255 stands for 255 or more.
 */
__kernel void distance_pass(__global const uchar *restrict in, __global uchar *restrict out, int4 cells, int axis)
{
  const int y = get_global_id(0), z = get_global_id(1);
  const int stride = axis == 0 ? 1 : axis == 1 ? cells.x : cells.x * cells.y;
  const int count = axis == 0 ? cells.x : axis == 1 ? cells.y : cells.z;
  for (int x = 0; x < cells.x; ++x) {
    const int place = axis == 0 ? x : axis == 1 ? y : z, at = (z * cells.y + y) * cells.x + x;
    int best = in[at];
    for (int k = 1; k < best; ++k) {
      if (place >= k) best = min(best, max(k, (int)in[at - k * stride]));
      if (place + k < count) best = min(best, max(k, (int)in[at + k * stride]));
    }
    out[at] = (uchar)best;
  }
}

/* The map of each octant of directions (skip_empty.h): distances to the nearest cell of the mask ahead, in no coordinate
 * behind. A work-item makes one map, from its far corner: a transparent cell is one farther than the nearest of the seven
 * cells ahead of it.
 *
 * maps  uchar [9, cells.z, cells.y, cells.x]: the first one is 0 in the mask, the others are written
 */
__kernel void octant_distances(__global uchar *maps, int4 cells)
{
  const int octant = get_global_id(0), nx = cells.x, ny = cells.y, nz = cells.z;
  const int right = octant & 1, down = octant >> 1 & 1, away = octant >> 2 & 1;
  __global uchar *map = maps + (size_t)(octant + 1) * nx * ny * nz;
  const int step = right ? 1 : -1, row = down ? nx : -nx, slice = away ? nx * ny : -nx * ny;
  for (int k = 0; k < nz; ++k)
    for (int j = 0; j < ny; ++j) {
      const int y = down ? ny - 1 - j : j, z = away ? nz - 1 - k : k;
      int at = (z * ny + y) * nx + (right ? nx - 1 : 0);
      int last = 254, before = 254; /* of the cell ahead in x: its own distance, and the least of the three beside it */
      for (int i = 0; i < nx; ++i, at -= step) {
        int beside = 254;
        if (j > 0) beside = min(beside, (int)map[at + row]);
        if (k > 0) beside = min(beside, (int)map[at + slice]);
        if (j > 0 && k > 0) beside = min(beside, (int)map[at + row + slice]);
        last = maps[at] ? 1 + min(min(beside, before), last) : 0;
        map[at] = (uchar)last;
        last = min(last, 254), before = beside;
      }
    }
}

#if VOXEL_BITS == 8
/* The layout of fetch_voxel.h: for each (z, y < size.y - 1, x) the voxels y and y + 1 side by side. */
__kernel void pair_rows(__global const uchar *restrict volume, int4 size, __global uchar *restrict pairs)
{
  const int y = get_global_id(0), z = get_global_id(1);
  __global const uchar *a = volume + ((size_t)z * size.y + y) * size.x, *b = a + size.x;
  __global uchar *out = pairs + 2 * ((size_t)z * (size.y - 1) + y) * size.x;
  for (int x = 0; x < size.x; ++x) out[2 * x] = a[x], out[2 * x + 1] = b[x];
}
#endif
