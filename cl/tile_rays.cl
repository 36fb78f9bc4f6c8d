/* Rays of a list of pixels, for pictures that are not cast whole (clvol/integrators/tiles). Switches and scene are
 * those of raycast.cl, the view that of the whole picture.
 *
 * What a lane computes does not depend on its neighbours, so a pixel is the same, bit for bit, as in a picture cast
 * whole.
 *
 * rays         int [count]: row * width + column, those of a tile after one another
 * count        how many there are
 * rays_an_item a multiple of LANES: rays that a work-item casts; view->first_tile is the first work-item of this launch
 * image        float4 [height, width], depths float [height, width] (only written if WITH_DEPTH): written where a ray
 *              is
 * changes      float [count]: mean square, over the channels, of the change that the ray made to what stood in `image`
 * samples      uint [work-items]
 */
#include "render_packet.h"

__kernel WIDE_VECTORS void tile_rays(SCENE_PARAMETERS, __global const int *restrict rays, const int count,
                                     const int rays_an_item, __global float4 *restrict image,
                                         __global float *restrict depths,
                                     __global float *restrict changes, __global uint *restrict samples COUNTS_PARAMETER)
{
  DECLARE_TALLIES
  const Scene scene = SCENE;
  const int item = (int)get_global_id(0) + view->first_tile;
  const int first = item * rays_an_item, end = min(first + rays_an_item, count);
  const int width = view->image.x, height = view->image.y;
  uint total = 0;
  _Pragma("unroll 1") for (int at = first; at < end; at += LANES) {
    float rgba[4 * LANES], depth[LANES];
    uint taken[LANES];
    int column[LANES], row[LANES];
    EACH_LANE_ROLLED(k)
    {
      const int pixel = rays[min(at + k, end - 1)];
      const int y = pixel / max(width, 1);
      column[k] = at + k < end ? pixel - y * width : width;
      row[k] = at + k < end ? y : height; /* outside: no ray */
    }
    render_packet(&scene, LOAD_LANES(column), LOAD_LANES(row), whole_span(), rgba, depth, taken, counted);
    EACH_LANE_ROLLED(k)
    {
      if (at + k < end) {
        const size_t pixel = (size_t)row[k] * width + column[k];
        float4 c = vload4(k, rgba);
        c.w = fmin(c.w, 1.0f); /* as raycast.cl */
        const float4 change = c - image[pixel];
        changes[at + k] = 0.25f * dot(change, change);
        image[pixel] = c;
#if WITH_DEPTH
        depths[pixel] = depth[k];
#endif
        total += taken[k];
      }
    }
  }
  STORE_TALLIES(item)
  samples[item] = total;
}
