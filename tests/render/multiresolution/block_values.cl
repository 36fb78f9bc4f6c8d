/* The field of blocks at given places, with and without interblock interpolation, as a march asks for it. */
#include "lanes.h"
#include "view.h"
#include "block_parameters.h"
#define QUEUED_STEPS 1
#include "blend_blocks.h"

/* at float [3, n]: x, y, z of places p; values float [n]; counts uint [n / LANES, BLOCK_COUNTERS]. n is a multiple of LANES. */
__kernel WIDE_VECTORS void block_values(__global const uchar *restrict volume, __constant const View *restrict view,
                                        __global const int *restrict index, __global const uint *restrict corners,
                                        __constant const Blocks *restrict blocks MORE_SAMPLE_PARAMETERS,
                                        __global const float *restrict at, int n, int interblock, __global float *restrict values,
                                        __global uint *restrict counts)
{
  const BlockVolume held = block_volume(volume, view, index, corners, blocks MORE_SAMPLE_ARGUMENTS);
  const BlockVolume *v = &held;
  const size_t first = get_global_id(0) * LANES;
  const floatN x = LOAD_LANES(at + first), y = LOAD_LANES(at + n + first), z = LOAD_LANES(at + 2 * n + first);
  Tally counted[BLOCK_COUNTERS] = {0};
  const Record here = record_at(v, x, y, z);
  const BlockSample fetched = fetch_in_block(v, &here, x, y, z);
  const floatN value = value_in_block(&fetched, view);
  count_lanes(&counted[COUNT_BLOCK_READS], ~(intN)0);
  float found[LANES];
  STORE_LANES(value, found);
#if LANES == 1
  if (interblock && fetched.outside) found[0] = blend_blocks(v, &here, x, y, z, value, counted);
#else
  PlaceQueue queue;
  queue.count = 0;
  if (interblock) queue_places(&queue, x, y, z, value, LANE_INDEX, fetched.outside);
  blend_queue(v, &queue, found, counted);
#endif
  EACH_LANE(k) values[first + k] = found[k];
  for (int k = 0; k < BLOCK_COUNTERS; ++k) counts[get_global_id(0) * BLOCK_COUNTERS + k] = tally_sum(counted[k]);
}
