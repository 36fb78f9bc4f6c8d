/* The field of blocks at given places, with and without interblock interpolation, as a march asks for it. */
#include "lanes.h"
#include "view.h"
#include "block_parameters.h"
#define QUEUED_STEPS 1
#define INTERBLOCK 1
#include "blend_blocks.h"

/* at float [3, n]: x, y, z of places p; values float [n]; counts uint [n / LANES, BLOCK_COUNTERS]. n is a multiple of LANES. */
__kernel WIDE_VECTORS void block_values(__global const uchar *restrict volume, __constant const View *restrict view,
                                        BLOCK_PARAMETERS,
                                        __global const float *restrict at, int n, int interblock, __global float *restrict values,
                                        __global uint *restrict counts)
{
  const BlockVolume held = BLOCK_VOLUME;
  const BlockVolume *v = &held;
  const size_t first = get_global_id(0) * LANES;
  const floatN x = LOAD_LANES(at + first), y = LOAD_LANES(at + n + first), z = LOAD_LANES(at + 2 * n + first);
  Tally counted[BLOCK_COUNTERS] = {0};
  const Record here = record_at(v, x, y, z);
  count_lanes(&counted[COUNT_BLOCK_READS], ~(intN)0);
#if LANES == 1
  const BlockPlace place = place_in_block(v, &here, x, y, z);
  float found[1] = {value_in_block(v, &place)};
  if (interblock && place.outside) found[0] = blend_blocks(v, &here, x, y, z, found[0], counted);
#else
  float found[FETCHES * LANES];
  Fetch fetches[FETCHES];
  PlaceQueue queue;
  PairQueue pairs;
  const intN outside = place_fetch(v, fetches, &here, alike(v, &here), x, y, z);
  queue.count = 0;
  queue_places(&queue, x, y, z, 0, interblock ? outside : (intN)0);
  const int vectors = 1 + (queue.count ? queue_pairs(v, &queue, &pairs, fetches + 1, counted) : 0);
  for (int k = 0; k < vectors; ++k) STORE_LANES(fetched_value(v, &fetches[k]), found + k * LANES);
  if (queue.count) {
    blend_pairs(&queue, &pairs, found + LANES);
    STORE_LANES(blended_value(&queue, 0, LOAD_LANES(found)), found);
  }
#endif
  EACH_LANE(k) values[first + k] = found[k];
  for (int k = 0; k < BLOCK_COUNTERS; ++k) counts[get_global_id(0) * BLOCK_COUNTERS + k] = tally_sum(counted[k]);
}
