/* The ray caster: a ray for every pixel. A work-item renders one tile of pixels, a packet of rays at a time
 * (render_packet.h).
 *
 * Switches (-D): LANES, VOXEL_BITS, VOXEL_SIGNED, VOXEL_SCALED, VOXEL_PAIRS, VOXEL_HOLES, FILTER, CLASSIFICATION,
 * QUADRATURE, TRANSFER_PIECES, SKIP_EMPTY, WITH_DEPTH.
 */
#include "chosen_tiles.h"
#include "render_packet.h"

/* The scene's arguments are described in scene.h.
 * image      float4 [height, width], premultiplied, linear
 * depths     float [height, width], world distance along the ray from the eye to where opacity reaches one half, else
 *            infinity
 * samples    uint [tiles], reconstructions of the volume
 */
__kernel WIDE_VECTORS void raycast(SCENE_PARAMETERS, __global float4 *restrict image, __global float *restrict depths,
                                   __global uint *restrict samples COUNTS_PARAMETER CHOSEN_PARAMETER)
{
  const Scene scene = SCENE;
  DECLARE_TALLIES
  const int width = view->image.x, height = view->image.y;
  const int columns = max(1, (width + view->tile.x - 1) / view->tile.x);
  const int item = (int)get_global_id(0) + view->first_tile, tile = TILE_OF(item);
  const int left = tile % columns * view->tile.x, top = tile / columns * view->tile.y;
  uint total = 0;
  for (int row = top; row < min(top + view->tile.y, height); row += PACKET_H)
    for (int column = left; column < min(left + view->tile.x, width); column += PACKET_W) {
      float rgba[4 * LANES], depth[LANES];
      uint taken[LANES];
      const intN lane = LANE_INDEX;
      const intN px = column + (lane & (PACKET_W - 1)), py = row + lane / PACKET_W;
      render_packet(&scene, px, py, rgba, depth, taken, counted);
      EACH_LANE(k)
      {
        const int x = column + k % PACKET_W, y = row + k / PACKET_W;
        if (x < width && y < height) {
          const size_t pixel = (size_t)y * width + x;
          float4 c = vload4(k, rgba);
          c.w = fmin(c.w, 1.0f); /* a sum of shares of what was left may round to more than all */
          image[pixel] = c;
#if WITH_DEPTH
          depths[pixel] = depth[k];
#endif
          total += taken[k];
        }
      }
    }
  STORE_TALLIES(item)
  samples[tile] = total;
}

#if EFFECTS
#define REPORTED_FIELDS VIEW_FIELDS, EFFECTS_FIELDS
#elif SLICES
#define REPORTED_FIELDS VIEW_FIELDS, SLICES_FIELDS
#elif BLOCKS
#define REPORTED_FIELDS VIEW_FIELDS, BLOCKS_FIELDS
#else
#define REPORTED_FIELDS VIEW_FIELDS
#endif
REPORT_FIELDS
