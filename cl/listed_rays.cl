/* Rays of a list of pixels (clvol.device.view.PixelList). Switches and scene are those of raycast.cl, the view that of
 * the whole picture, of which nothing is held: the image is the list's own.
 *
 * What a lane computes does not depend on its neighbours, so a pixel is the same, bit for bit, as in a picture cast
 * whole.
 *
 * listed   int2 [tiles, rays of a tile]: column and row of each pixel, those of a packet close together where that is
 *          possible; below 0: no ray. A tile has view->tile.x * view->tile.y rays, a multiple of LANES
 * image    float4, depths float (only written if WITH_DEPTH): one per ray; samples uint [tiles]; as in raycast.cl
 */
#include "chosen_tiles.h"
#include "render_packet.h"

/* Pixels, in the tile's list, of the packet that begins at `at`; those of lanes without a ray are outside. */
INLINE void load_places(__global const int2 *restrict listed, __constant const View *view, int at, int *column,
                        int *row)
{
  EACH_LANE_ROLLED(k)
  {
    const int2 place = listed[at + k];
    column[k] = place.x < 0 ? view->image.x : place.x;
    row[k] = place.x < 0 ? view->image.y : place.y;
  }
}

#if SPANS
#define WIDEST 16 /* pixels that a packet may be wide and still leap as one */

/* The spans of LANES packets that follow one another; whole ones where a packet's rays are far apart. */
RARE void spans_of_rays(__global const uchar *distances, __constant const View *view,
                        __global const int2 *restrict listed, int at, int packets, float *from, float *to,
                        Tally *counted)
{
  float u[LANES], v[LANES], half_u[LANES], half_v[LANES];
  int far[LANES];
  _Pragma("unroll 1") for (int p = 0; p < LANES; ++p) {
    int2 low = INT_MAX, high = -1;
    _Pragma("unroll 1") for (int k = 0; k < LANES && p < packets; ++k) {
      const int2 place = listed[at + p * LANES + k];
      if (place.x >= 0) low = min(low, place), high = max(high, place);
    }
    const int none = high.x < 0;
    const int2 width = none ? 0 : high - low;
    far[p] = none || width.x > WIDEST || width.y > WIDEST;
    half_u[p] = 0.5f * (float)width.x, half_v[p] = 0.5f * (float)width.y;
    u[p] = (none ? 0.0f : (float)low.x) + half_u[p] - view->centre.x;
    v[p] = (none ? 0.0f : (float)low.y) + half_v[p] - view->centre.y;
  }
  frustum_spans(distances, view, LOAD_LANES(u), LOAD_LANES(v), LOAD_LANES(half_u), LOAD_LANES(half_v), from, to,
                counted);
  EACH_LANE_ROLLED(p) if (far[p]) from[p] = -INFINITY, to[p] = INFINITY;
}
#endif

__kernel WIDE_VECTORS void listed_rays(SCENE_PARAMETERS, __global const int2 *restrict listed,
                                       __global float4 *restrict image, __global float *restrict depths,
                                       __global uint *restrict samples COUNTS_PARAMETER CHOSEN_PARAMETER)
{
  DECLARE_TALLIES
  const Scene scene = SCENE;
  const int item = (int)get_global_id(0) + view->first_tile, tile = TILE_OF(item);
  const int rays = view->tile.x * view->tile.y, first = tile * rays, end = view->image.x > 0 ? first + rays : first;
  uint total = 0;
#if SPANS
  float from[LANES], to[LANES];
#endif
  _Pragma("unroll 1") for (int at = first; at < end; at += LANES) {
    float rgba[4 * LANES], depth[LANES];
    uint taken[LANES];
    int column[LANES], row[LANES];
    load_places(listed, view, at, column, row);
#if SPANS
    const int packet = (at - first) / LANES;
    if (packet % LANES == 0) spans_of_rays(distances, view, listed, at, (end - at) / LANES, from, to, counted);
    const Span span = span_between((floatN)from[packet % LANES], (floatN)to[packet % LANES]);
    if (from[packet % LANES] > to[packet % LANES]) {
      EACH_LANE_ROLLED(k)
      {
        image[at + k] = 0.0f;
#if WITH_DEPTH
        depths[at + k] = INFINITY;
#endif
      }
      continue;
    }
#else
    const Span span = whole_span();
#endif
    render_packet(&scene, LOAD_LANES(column), LOAD_LANES(row), span, rgba, depth, taken, counted);
    EACH_LANE_ROLLED(k)
    {
      float4 c = vload4(k, rgba);
      c.w = fmin(c.w, 1.0f); /* as raycast.cl */
      image[at + k] = c;
#if WITH_DEPTH
      depths[at + k] = depth[k];
#endif
      total += column[k] < view->image.x ? taken[k] : 0;
    }
  }
  STORE_TALLIES(item)
  samples[tile] = total;
}
