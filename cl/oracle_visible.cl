/* Which cells of an oracle's map can show anything (clvol/render/pyramid/oracles/visible.py): cubes of 2^shift lattice cells.
 *
 * Switches (-D): LANES (1), those of voxels, WARPED_CLASSES.
 */
#include "lanes.h"
#include "view.h"
#include "shows_between.h"
#include "voxel_type.h"

/* visible  uchar [cells.z, cells.y, stride]: bit `bit` is set where anything between the voxels of the cell, its upper faces included, can be
 *          seen, or one of them is not finite; bit 0 clears the others, which otherwise stay. Others as for visible_block_cells. */
__kernel void visible_cells(__global const Voxel *restrict volume, __global const float *restrict warp, __global const int *restrict before,
                            __global const uchar *restrict at, __constant const View *restrict view, int shift, int4 cells, int stride, int bit,
                            __global uchar *restrict visible)
{
  const int cy = get_global_id(0), cz = get_global_id(1), edge = 1 << shift;
  const int4 size = view->size;
  const int y0 = cy << shift, z0 = cz << shift, y1 = min(y0 + edge, size.y - 1), z1 = min(z0 + edge, size.z - 1);
  __global uchar *out = visible + ((size_t)cz * cells.y + cy) * stride;
  for (int cx = 0; cx < stride; ++cx) {
    const int x0 = cx << shift, x1 = min(x0 + edge, size.x - 1);
    float low = INFINITY, high = -INFINITY;
    int hole = 0;
    if (cx < cells.x)
      for (int z = z0; z <= z1; ++z)
        for (int y = y0; y <= y1; ++y)
          for (int x = x0; x <= x1; ++x) {
            const Voxel voxel = volume[((size_t)z * size.y + y) * size.x + x];
#if VOXEL_BITS == 64
            const float v = (float)((voxel - view->voxel_double.x) * view->voxel_double.y);
#elif VOXEL_SCALED
            const float v = voxel * view->voxel.x;
#else
            const float v = (float)voxel;
#endif
            if (isfinite(v))
              low = fmin(low, v), high = fmax(high, v);
            else
              hole = 1;
          }
    const int shown = shows_between(low, high, warp, before, at, view) || (hole && low <= high);
    out[cx] = (uchar)((bit ? out[cx] : 0) | shown << bit);
  }
}
