/* The acceleration structure for empty space: a min-max grid of the volume (built once), the cells in which the
 * transfer function shows anything (once a transfer function, on the host: a few thousand cells), and the distance map
 * from them.
 *
 * Switches (-D): VOXEL_BITS, VOXEL_SIGNED.
 */
#include "voxel_type.h"

#if VOXEL_BITS >= 32
#define IS_VALUE(v) isfinite(v)
#else
#define IS_VALUE(v) 1
#endif

/* Smallest and largest finite voxel of each cell of edge^3 lattice cells, its upper faces and `apron` voxels more on
 * each side included (0: (edge + 1)^3 voxels): whatever a filter that reaches so far interpolates inside lies between.
 * A cell without any has low > high.
 *
 * volume  Voxel [size.z, size.y, size.x]; cells Voxel [cells.z, cells.y, cells.x, 2] (low, high)
 */
__kernel void min_max_cells(__global const Voxel *restrict volume, int4 size, int edge, int apron,
                            __global Voxel *restrict cells)
{
  const int cx = get_global_id(0), cy = get_global_id(1), cz = get_global_id(2);
  const int x0 = max(cx * edge - apron, 0), y0 = max(cy * edge - apron, 0), z0 = max(cz * edge - apron, 0);
  const int x1 = min((cx + 1) * edge + apron, size.x - 1), y1 = min((cy + 1) * edge + apron, size.y - 1),
            z1 = min((cz + 1) * edge + apron, size.z - 1);
  Voxel low = 1, high = 0;
  int any_value = 0;
  for (int z = z0; z <= z1; ++z)
    for (int y = y0; y <= y1; ++y) {
      __global const Voxel *row = volume + ((size_t)z * size.y + y) * size.x;
      for (int x = x0; x <= x1; ++x) {
        const Voxel v = row[x];
        if (!IS_VALUE(v)) continue;
        low = any_value && low < v ? low : v;
        high = any_value && high > v ? high : v;
        any_value = 1;
      }
    }
  __global Voxel *out = cells + 2 * (((size_t)cz * get_global_size(1) + cy) * get_global_size(0) + cx);
  out[0] = low, out[1] = high;
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
