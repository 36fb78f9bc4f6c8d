/* The method "pyramid" (cl/pyramid.h): a work-group renders one tile of TILE by TILE pixels.
 *
 * Switches (-D): LANES, WORKERS, TILE, ORACLE, LEAPS, and those of voxels and classification as for raycast.cl.
 */
#include "chosen_tiles.h"
#include "half_opacity.h"
#include "pyramid_leap.h"
#include "pyramid_pixels.h"
#include "scene.h"

#define PACKETS_IN_ROW (TILE / PACKET_W)
#define PACKETS (TILE * TILE / LANES / WORKERS) /* a work-item's */

/* As for raycast.cl, and
 * pyramid  numbers of the frame and of the oracle
 * map      the oracle's own (oracle.h)
 * distances  here: from cells to anything visible, as bytes of oracle.h
 * counts   uint [tiles or items, PYRAMID_COUNTERS]
 * and of a volume of blocks what block_parameters.h says
 */
__kernel WIDE_VECTORS __attribute__((reqd_work_group_size(WORKERS, 1, 1))) void pyramid(
  SCENE_PARAMETERS, __global float4 *restrict image, __global float *restrict depths, __global uint *restrict samples,
  __constant const Pyramid *restrict pyramid, __global const uchar *restrict map,
  __global uint *restrict counts CHOSEN_PARAMETER)
{
  Tally counted[PYRAMID_COUNTERS] = {0}, taken = 0;
#if BLOCKS
  const BlockVolume block_samples = BLOCK_VOLUME;
  const Source source = {volume, view, pyramid, map, &block_samples, counted + PYRAMID_COUNTERS - BLOCK_COUNTERS};
#elif EFFECTS
  const Scene scene = SCENE;
#if HELD_LIGHT
  LightQueue queue;
  queue.count = queue.segments = 0;
#endif
#else
  const Source source = {volume, view, pyramid, map};
#endif
  const int width = view->image.x, height = view->image.y;
  const int columns = max(1, (width + TILE - 1) / TILE), rows = max(1, (height + TILE - 1) / TILE);
  /* From the top and the bottom in turns: the last ones, by which cores wait for each other, are then in the middle,
   * where much is to be seen, and drivers hand out few at a time in the end. */
  const int place = (int)get_group_id(0) + view->first_tile, some = width > 0;
#if TILES_CHOSEN
  const int tile = TILE_OF(place), counts_row = place;
#else
  const int tile = !some ? place : place & 1 ? columns * rows - 1 - place / 2 : place / 2, counts_row = tile;
#endif
  const int left = tile % columns * TILE, top = tile / columns * TILE;
  const int levels = pyramid->levels + pyramid->oversampling;
#if WORKERS > 1
  __local Levels shared;
#else
  Levels shared;
#endif
  SHARED Levels *m = &shared;
  PixelPacket packets[PACKETS];
#if EFFECTS && HELD_LIGHT
  const Source source = {volume, view, pyramid, map, &scene, &queue, packets};
#elif EFFECTS
  const Source source = {volume, view, pyramid, map, &scene};
#endif
  /* Slices at which all pixels take part, and where chunks begin. */
  const int period = max(CHUNK, 1 << pyramid->levels);
  const int columns_of_tile = levels < LEAST_LEVEL ? 1 : (TILE >> levels) * (TILE >> levels);
  float begin = INFINITY, last_enter = -INFINITY, first_leave = INFINITY;
  if (width > 0) {
    prepare_levels(view, m, levels, left, top);
    for (int q = 0; q < PACKETS; ++q) {
      const int p = q * WORKERS + WORKER;
      PixelPacket *packet = &packets[q];
      if (prepare_packet(view, pyramid, packet, left + p % PACKETS_IN_ROW * PACKET_W,
                         top + p / PACKETS_IN_ROW * PACKET_H))
        EACH_LANE(k) if (packet->alive[k])
        {
          begin = fmin(begin, packet->enter[k]), last_enter = fmax(last_enter, packet->enter[k]);
          first_leave = fmin(first_leave, packet->leave[k]);
        }
    }
  }
  begin = group_min(m, fmax(begin, 0.0f));
  first_leave = group_min(m, fmax(first_leave, 0.0f)), last_enter = group_max(m, fmax(last_enter, 0.0f));
  int base = begin < INFINITY ? (int)begin / period * period : 0;
  int alive = begin < INFINITY;
#if EFFECTS && ISOSURFACES && !TRANSLUCENT
  /* Nothing needs samples: all is as in empty space. */
  for (int q = 0; q < (alive ? PACKETS : 0); ++q)
    pass_empty_slices(&source, &packets[q], INFINITY, &taken, counted);
  alive = 0;
#endif
  while (alive) {
    const int well_inside = (float)base > last_enter && (float)(base + CHUNK) < first_leave;
    update_levels(&source, m, base, 0, 1, well_inside, &taken, counted);
#if LEAPS
    send_to_sleep(&source, m, distances, base, period);
#endif
    int is_awake = 0;
    for (int c = 0; c < columns_of_tile; ++c) is_awake |= m->slices[c] > 1;
    for (int i = 1; i < CHUNK && (WORKERS > 1 || is_awake); ++i)
      update_levels(&source, m, base + i, i, is_awake, well_inside, &taken, counted);
    int goes_on = 0, next = INT_MAX;
    for (int q = 0; q < PACKETS; ++q) {
      const int p = q * WORKERS + WORKER, column = p % PACKETS_IN_ROW * PACKET_W, row = p / PACKETS_IN_ROW * PACKET_H;
      const int c = levels < LEAST_LEVEL ? 0 : (row >> levels) * (TILE >> levels) + (column >> levels);
      const int slices = m->slices[c];
      int alive_here;
      if (slices)
        alive_here = march_packet(&source, m, &packets[q], column, row, base, slices, table, &taken, counted);
      else
        alive_here = any_lane(LOAD_LANES(packets[q].alive));
#if EFFECTS && ISOSURFACES
      if (slices == 1 && alive_here)
        alive_here = pass_empty_slices(&source, &packets[q], (float)m->wakes[c], &taken, counted);
#endif
      if (slices == 1 && alive_here) alive_here = restart_packet(&packets[q], m->wakes[c]);
      if (alive_here) next = min(next, max(base + CHUNK, m->wakes[c]));
      goes_on |= alive_here;
    }
    SYNCHRONISE();
    alive = group_any(m, goes_on);
    base = (int)group_min(m, (float)next);
  }
#if HELD_LIGHT
  light_queue(&scene, &queue, packets, EFFECT_TALLIES(counted));
#endif
  if (width > 0)
    for (int q = 0; q < PACKETS; ++q) {
      const int p = q * WORKERS + WORKER;
#if HELD_LIGHT
      EACH_LANE(k)
      {
        const PixelPacket *done = &packets[q];
        vstore4((float4)(done->r[k], done->g[k], done->b[k], done->opacity[k]), k, packets[q].rgba);
      }
#endif
#if ENVIRONMENT_VISIBLE
      show_behind(&source, &packets[q], left + p % PACKETS_IN_ROW * PACKET_W, top + p / PACKETS_IN_ROW * PACKET_H);
#endif
#if WITH_DEPTH
      float places[LANES];
      STORE_LANES(half_place(&packets[q].half_, 1.0f, table, view), places);
#endif
      EACH_LANE(k)
      {
        const int x = left + p % PACKETS_IN_ROW * PACKET_W + k % PACKET_W;
        const int y = top + p / PACKETS_IN_ROW * PACKET_H + k / PACKET_W;
        if (x < width && y < height) {
          const size_t pixel = (size_t)y * width + x;
          float4 c = vload4(k, packets[q].rgba);
          c.w = fmin(c.w, 1.0f); /* a sum of shares of what was left may round to more than all */
          image[pixel] = c;
#if WITH_DEPTH
          depths[pixel] = (view->plane_distance + places[k] * view->step) * view->edge_length;
#endif
        }
      }
    }
  /* Sums over the group. */
#if WORKERS > 1
  __local uint sums[PYRAMID_COUNTERS + 1];
  if (WORKER <= PYRAMID_COUNTERS) sums[WORKER] = 0;
  SYNCHRONISE();
  for (int c = 0; c < PYRAMID_COUNTERS; ++c) atomic_add(&sums[c], tally_sum(counted[c]));
  atomic_add(&sums[PYRAMID_COUNTERS], tally_sum(taken));
  SYNCHRONISE();
  if (WORKER == 0) {
    for (int c = 0; c < PYRAMID_COUNTERS; ++c) counts[(size_t)counts_row * PYRAMID_COUNTERS + c] = sums[c];
    samples[tile] = sums[PYRAMID_COUNTERS];
  }
#else
  for (int c = 0; c < PYRAMID_COUNTERS; ++c) counts[(size_t)counts_row * PYRAMID_COUNTERS + c] = tally_sum(counted[c]);
  samples[tile] = tally_sum(taken);
#endif
}

#if BLOCKS
#define REPORTED_FIELDS VIEW_FIELDS, PYRAMID_FIELDS, BLOCKS_FIELDS
#elif EFFECTS
#define REPORTED_FIELDS VIEW_FIELDS, PYRAMID_FIELDS, EFFECTS_FIELDS
#else
#define REPORTED_FIELDS VIEW_FIELDS, PYRAMID_FIELDS
#endif
REPORT_FIELDS
