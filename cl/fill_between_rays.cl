/* Image sampling: the rays of every n-th pixel of every n-th row are there (`coarse`: a lattice's picture, from
 * raycast.cl); what lies between four of them is interpolated where they agree, and gets a ray of its own where not.
 *
 * coarse         float4 [rows, columns] of the lattice; view->ray_spacing is n, view->lattice columns and rows;
 *                view->ray_tolerance: how far apart the four corners may be in any channel
 * coarse_depths  float [rows, columns] (only read if WITH_DEPTH)
 * samples, rays  uint [tiles]
 */
#include "chosen_tiles.h"
#include "render_packet.h"

typedef struct {
  float4 rgba;
  float depth;
  int agree;
} Interpolated;

INLINE Interpolated between_rays(__global const float4 *coarse, __global const float *coarse_depths,
                                 __constant const View *view,
                                 int x, int y)
{
  Interpolated between;
  const int n = view->ray_spacing, columns = view->lattice.x, rows = view->lattice.y;
  const int cx = x / n, cy = y / n;
  const float fx = (float)(x - cx * n) / (float)n, fy = (float)(y - cy * n) / (float)n;
  const int right = fx > 0.0f, below = fy > 0.0f;
  between.rgba = 0.0f, between.depth = INFINITY, between.agree = 0;
  if (cx + right >= columns || cy + below >= rows) return between;
  const size_t at = (size_t)cy * columns + cx, down = below ? columns : 0;
  const float4 c00 = coarse[at], c10 = coarse[at + right], c01 = coarse[at + down], c11 = coarse[at + down + right];
  const float4 range = fmax(fmax(c00, c10), fmax(c01, c11)) - fmin(fmin(c00, c10), fmin(c01, c11));
  const float4 top = c00 + fx * (c10 - c00), bottom = c01 + fx * (c11 - c01);
  between.rgba = top + fy * (bottom - top);
  between.agree = fmax(fmax(range.x, range.y), fmax(range.z, range.w)) <= view->ray_tolerance || !(right | below);
#if WITH_DEPTH
  const float d00 = coarse_depths[at], d10 = coarse_depths[at + right];
  const float d01 = coarse_depths[at + down], d11 = coarse_depths[at + down + right];
  const float depth = (1.0f - fy) * ((1.0f - fx) * d00 + fx * d10) + fy * ((1.0f - fx) * d01 + fx * d11);
  const int finite = (d00 < INFINITY) + (d10 < INFINITY) + (d01 < INFINITY) + (d11 < INFINITY);
  between.depth = finite == 4 ? depth : right | below ? INFINITY : d00;
  between.agree &= finite == 0 || finite == 4 || !(right | below); /* no depth between something and nothing */
#endif
  return between;
}

__kernel WIDE_VECTORS void fill_between_rays(SCENE_PARAMETERS, __global const float4 *restrict coarse,
                                             __global const float *restrict coarse_depths,
                                                 __global float4 *restrict image,
                                             __global float *restrict depths, __global uint *restrict samples,
                                             __global uint *restrict rays COUNTS_PARAMETER CHOSEN_PARAMETER)
{
  DECLARE_TALLIES
  const Scene scene = SCENE;
  const int width = view->image.x, height = view->image.y;
  const int columns = max(1, (width + view->tile.x - 1) / view->tile.x);
  const int item = (int)get_global_id(0) + view->first_tile, tile = TILE_OF(item);
  const int left = tile % columns * view->tile.x, top = tile / columns * view->tile.y;
  const int right = min(left + view->tile.x, width), bottom = min(top + view->tile.y, height);
  int column[LANES], row[LANES];
  uint total = 0, traced = 0;
  int waiting = 0, x = left, y = top;
  /* Pixels are gathered until a packet is full, or the tile is done. */
  while (y < bottom || waiting > 0) {
    for (; y < bottom && waiting < LANES; x = x + 1 < right ? x + 1 : left, y += x == left) {
      const Interpolated between = between_rays(coarse, coarse_depths, view, x, y);
      if (between.agree) {
        const size_t pixel = (size_t)y * width + x;
        image[pixel] = between.rgba;
#if WITH_DEPTH
        depths[pixel] = between.depth;
#endif
      } else {
        column[waiting] = x, row[waiting] = y;
        ++waiting;
      }
    }
    if (waiting == 0) break;
    float rgba[4 * LANES], depth[LANES];
    uint taken[LANES];
    for (int k = waiting; k < LANES; ++k) column[k] = width, row[k] = height; /* outside: no ray */
    render_packet(&scene, LOAD_LANES(column), LOAD_LANES(row), whole_span(), rgba, depth, taken, counted);
    for (int k = 0; k < waiting; ++k) {
      const size_t pixel = (size_t)row[k] * width + column[k];
      image[pixel] = vload4(k, rgba);
#if WITH_DEPTH
      depths[pixel] = depth[k];
#endif
      total += taken[k];
    }
    traced += (uint)waiting;
    waiting = 0;
  }
  STORE_TALLIES(item)
  samples[tile] = total;
  rays[tile] = traced;
}
