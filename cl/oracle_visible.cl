/* Which cells of an oracle's map can show anything (clvol/integrators/pyramid/oracles/visible.py): cubes of 2^shift
 * lattice cells.
 *
 * Switches (-D): LANES (1), those of voxels, WARPED_CLASSES.
 */
#include "lanes.h"
#include "view.h"
#include "shows_between.h"
#include "voxel_boxes.h"
#include "voxel_type.h"

/* volume   a box of voxels, with the apron and one more around its own, which are those of whole cells
 * apron    voxels around a cell that its values depend on; overshoot: share of their range that these may be beyond it
 * visible  uchar [cells.z, cells.y, stride]: bit `bit` is set where anything between the voxels of the cell, its upper
 *          faces included, can be seen, or one of them is not finite; bit 0 clears the others, which otherwise stay.
 *          Others as for visible_block_cells. */
__kernel void visible_cells(BOX_PARAMETERS, __global const float *restrict warp,
                            __global const int *restrict before,
                            __global const uchar *restrict at, __constant const View *restrict view, int shift,
                                int apron, float overshoot,
                            int4 cells, int stride, int bit,
                            __global uchar *restrict visible)
{
  const int cy = (int)get_global_id(0) + (begin.x >> shift), cz = (int)get_global_id(1) + (begin.y >> shift);
  const int edge = 1 << shift;
  const int4 size = view->size;
  const int y0 = max((cy << shift) - apron, 0), y1 = min((cy << shift) + edge + apron, size.y - 1);
  const int z0 = max((cz << shift) - apron, 0), z1 = min((cz << shift) + edge + apron, size.z - 1);
  __global uchar *out = visible + ((size_t)cz * cells.y + cy) * stride;
  for (int cx = 0; cx < stride; ++cx) {
    const int x0 = max((cx << shift) - apron, 0), x1 = min((cx << shift) + edge + apron, size.x - 1);
    float low = INFINITY, high = -INFINITY;
    int hole = 0;
    if (cx < cells.x)
      for (int z = z0; z <= z1; ++z)
        for (int y = y0; y <= y1; ++y)
          for (int x = x0; x <= x1; ++x) {
            const Voxel voxel = volume[BOX_ROW(y, z) + x];
#if VOXEL_BITS == 64
            const float v = (float)((voxel - view->voxel_bias_double) * view->voxel_gain_double);
#elif VOXEL_SCALED
            const float v = voxel * view->voxel_gain;
#else
            const float v = (float)voxel;
#endif
            if (isfinite(v))
              low = fmin(low, v), high = fmax(high, v);
            else
              hole = 1;
          }
    const float more = high > low ? overshoot * (high - low) * 1.0001f : 0.0f;
    low -= more, high += more;
    const int shown = shows_between(low, high, warp, before, at, view) || (hole && low <= high);
    out[cx] = (uchar)((bit ? out[cx] : 0) | shown << bit);
  }
}
