/* The ray caster: a ray for every pixel. A work-item renders one tile of pixels, a packet of rays at a time (render_packet.h).
 *
 * Switches (-D): LANES, VOXEL_BITS, VOXEL_SIGNED, VOXEL_SCALED, VOXEL_PAIRS, VOXEL_HOLES, FILTER, CLASSIFICATION, QUADRATURE,
 * TRANSFER_PIECES, SKIP_EMPTY, WITH_DEPTH.
 */
#include "render_packet.h"

/* volume     voxels in their own type, laid out as fetch_voxel.h says
 * table      pieces of the transfer function, see transfer_pieces.h
 * warp       not read: of kernels that find what is visible (shows_between.h)
 * distances  a byte a cell, see skip_empty.h (only read if SKIP_EMPTY)
 * image      float4 [height, width], premultiplied, linear
 * depths     float [height, width], world distance along the ray from the eye to where opacity reaches one half, else infinity
 * samples    uint [tiles], reconstructions of the volume
 */
__kernel WIDE_VECTORS void raycast(__global const uchar *restrict volume, __global const float *restrict table,
                                   __global const float *restrict warp, __global const uchar *restrict distances,
                                   __constant const View *restrict view, __global float4 *restrict image,
                                   __global float *restrict depths, __global uint *restrict samples EFFECT_PARAMETERS CHOSEN_PARAMETER)
{
  EFFECT_TALLY
  const int width = view->image.x, height = view->image.y;
  const int columns = max(1, (width + view->image.z - 1) / view->image.z);
  const int tile = (int)get_global_id(0) + view->band.x;
  RETURN_UNLESS_CHOSEN(tile)
  const int left = tile % columns * view->image.z, top = tile / columns * view->image.w;
  uint total = 0;
  for (int row = top; row < min(top + view->image.w, height); row += PACKET_H)
    for (int column = left; column < min(left + view->image.z, width); column += PACKET_W) {
      float rgba[4 * LANES], depth[LANES];
      uint taken[LANES];
      const intN lane = LANE_INDEX;
      const intN px = column + (lane & (PACKET_W - 1)), py = row + lane / PACKET_W;
      render_packet(volume, table, warp, distances, view EFFECT_ARGUMENTS, px, py, rgba, depth, taken);
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
  EFFECT_STORE_TALLY(tile)
  samples[tile] = total;
}

/* The sizes of View and Effects on the device: the host compares them with its own. */
__kernel void view_size(__global uint *size) { size[0] = (uint)sizeof(View), size[1] = (uint)sizeof(Effects); }
