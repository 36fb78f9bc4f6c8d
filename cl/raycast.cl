/* The ray caster: a ray for every pixel. A work-item renders one tile of pixels, a packet of rays at a time
 * (render_packet.h).
 *
 * Switches (-D): LANES, VOXEL_BITS, VOXEL_SIGNED, VOXEL_SCALED, VOXEL_PAIRS, VOXEL_HOLES, FILTER, CLASSIFICATION,
 * QUADRATURE, TRANSFER_PIECES, SKIP_EMPTY, WITH_DEPTH, COHERENT.
 */
#include "chosen_tiles.h"
#include "coherence.h"
#include "render_packet.h"

/* The scene's arguments are described in scene.h.
 * image      float4 [height, width], premultiplied, linear
 * depths     float [height, width], world distance along the ray from the eye to where opacity reaches one half, else
 *            infinity; with OWNED_BOX the opacity in front of this device's box, before
 * samples    uint [tiles], reconstructions of the volume
 * starts, kept, tallies   where COHERENT is set (coherence.h)
 */
#if LANES == 16
/* The pixels of a packet that sees nothing. `keeps`: INFINITY where no ray is needed to find that again. */
INLINE void write_nothing(__global float4 *image, __global float *depths KEPT_PARAMETER, int width, int column, int row,
                          int right, int bottom, float keeps)
{
  const int whole = column + PACKET_W <= right && row + PACKET_H <= bottom;
  for (int y = row; y < min(row + PACKET_H, bottom); ++y) {
    const size_t first = (size_t)y * width + column;
    if (whole) { /* a row of pixels is a vector */
      vstore16((float16)0.0f, 0, (__global float *)(image + first));
      if (WITH_DEPTH) vstore4((float4)INFINITY, 0, depths + first);
      STORE_KEPT4(keeps, first)
      continue;
    }
    for (int x = 0; x < min(PACKET_W, right - column); ++x) {
      image[first + x] = 0.0f;
      if (WITH_DEPTH) depths[first + x] = INFINITY;
      STORE_KEPT(keeps, first + x)
    }
  }
}
#endif

__kernel WIDE_VECTORS void raycast(SCENE_PARAMETERS, __global float4 *restrict image, __global float *restrict depths,
                                   __global uint *restrict samples COHERENT_PARAMETERS COUNTS_PARAMETER
                                   CHOSEN_PARAMETER)
{
  DECLARE_TALLIES
  const Scene scene = SCENE;
  const int width = view->image.x, height = view->image.y;
  const int columns = max(1, (width + view->tile.x - 1) / view->tile.x);
  const int item = (int)get_global_id(0) + view->first_tile, tile = TILE_OF(item);
  const int left = tile % columns * view->tile.x, top = tile / columns * view->tile.y;
  const int right = min(left + view->tile.x, width), bottom = min(top + view->tile.y, height);
  const int across = (view->tile.x + PACKET_W - 1) / PACKET_W;
  const int packets = across * ((view->tile.y + PACKET_H - 1) / PACKET_H);
  float from[LANES], to[LANES];
  uint total = 0;
#if COHERENT
  Tally tally[4] = {0, 0, 0, 0};
#endif
  for (int packet = 0; packet < packets; ++packet) {
#if SPANS
    if (packet % LANES == 0) {
      const intN each = packet + LANE_INDEX;
      packet_spans(distances, view, left + each % across * PACKET_W, top + each / across * PACKET_H, from, to, counted);
    }
    Span span = span_between((floatN)from[packet % LANES], (floatN)to[packet % LANES]);
#else
    Span span = whole_span();
#endif
    const int column = left + packet % across * PACKET_W, row = top + packet / across * PACKET_H;
    if (column >= right || row >= bottom) continue;
#if SPANS
    if (from[packet % LANES] > to[packet % LANES]) {
      write_nothing(image, depths KEPT_ARGUMENT, width, column, row, right, bottom, INFINITY);
      continue;
    }
#endif
#if COHERENT
    const floatN start = start_of_lanes(starts, view, column, row);
    const intN audited = audited_lanes(start);
    const floatN from_here = lane_max(span.from, select(start, -(floatN)INFINITY, audited));
#if SPANS
    if (!any_lane(MASK(from_here <= span.to))) {
      write_nothing(image, depths KEPT_ARGUMENT, width, column, row, right, bottom, KEPT_EXIT(view->deepest));
      count_lanes(&tally[TALLY_REUSED], MASK(start > -(floatN)INFINITY));
      continue;
    }
#endif
    span.from = from_here;
#endif
    float rgba[4 * LANES], depth[LANES];
    uint taken[LANES];
#if OWNED_BOX && WITH_DEPTH
    EACH_LANE(k)
    {
      const int x = column + k % PACKET_W, y = row + k / PACKET_W;
      depth[k] = x < width && y < height ? depths[(size_t)y * width + x] : 0.0f;
    }
#endif
    const intN lane = LANE_INDEX;
    const intN px = column + (lane & (PACKET_W - 1)), py = row + lane / PACKET_W;
#if COHERENT
    floatN first = INFINITY;
    float kept_depth[LANES];
#endif
    render_packet(&scene, px, py, span, rgba, depth, taken, counted FIRST_ARGUMENT);
#if COHERENT
    const floatN keeps = depth_to_keep(view, px, py, first);
    const intN known = MASK(start > -(floatN)INFINITY), meets = MASK(keeps < INFINITY);
    const intN hits = meets & MASK(keeps >= 0.0f);
    STORE_LANES(keeps, kept_depth);
    count_lanes(&tally[TALLY_REUSED], known & meets & ~audited), count_lanes(&tally[TALLY_HOLES], hits & ~known);
    count_lanes(&tally[TALLY_LATE], audited & hits & MASK(keeps < start - NOT_LATE));
    tally[TALLY_AUDITED] += LOAD_LANES(taken) & AS_UINT(audited);
#endif
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
#if COHERENT
        kept[pixel] = kept_depth[k];
#endif
        total += taken[k];
      }
    }
  }
  STORE_TALLIES(item)
  samples[tile] = total;
#if COHERENT
  for (int k = 0; k < 4; ++k) tallies[4 * (size_t)tile + k] = tally_sum(tally[k]);
#endif
}

#if EFFECTS && SLICES
#define REPORTED_FIELDS VIEW_FIELDS, EFFECTS_FIELDS, HALF_ANGLE_FIELDS
#elif EFFECTS && BLOCKS
#define REPORTED_FIELDS VIEW_FIELDS, EFFECTS_FIELDS, BLOCKS_FIELDS
#elif EFFECTS
#define REPORTED_FIELDS VIEW_FIELDS, EFFECTS_FIELDS
#elif SLICES
#define REPORTED_FIELDS VIEW_FIELDS, SLICES_FIELDS
#elif BLOCKS
#define REPORTED_FIELDS VIEW_FIELDS, BLOCKS_FIELDS
#else
#define REPORTED_FIELDS VIEW_FIELDS
#endif
REPORT_FIELDS
