/* Values of a packet of rays at several places each, taken together: places come first, then all values in as few
 * passes as they fill. So the loads of many vectors are under way at once, and what is blended between blocks fills
 * vectors of its own (blend_blocks.h). At most QUEUED_STEPS places of a packet are a run.
 *
 *   run_begin(&run);
 *   run_place(v, &run, k, &here, kind, x, y, z, wanted, tally);   for k = 0, 1, ..., n - 1
 *   run_end(v, &run, n, tally);
 *   run_value(&run, k)
 *
 * Lanes that are not `wanted` get a value without its neighbours' shares.
 */
#ifndef BLOCK_RUNS_H
#define BLOCK_RUNS_H

#include "blend_blocks.h"
#include "blocks.h"
#include "tally.h"

typedef struct {
#if LANES > 1
  float value[FETCHES * LANES]; /* of samples, then of pairs that are blended in */
  Fetch fetches[FETCHES];
#if INTERBLOCK
  PlaceQueue queue;
#endif
#else
  float value[QUEUED_STEPS];
#endif
} BlockRun;

INLINE void run_begin(BlockRun *run)
{
#if LANES > 1 && INTERBLOCK
  run->queue.count = 0;
#endif
}

/* The place (px, py, pz), which is in the blocks `here`; `kind`: alike() of them. */
INLINE void run_place(const BlockVolume *v, BlockRun *run, int k, const Record *here, int kind, floatN px, floatN py,
                      floatN pz, intN wanted, Tally *tally)
{
#if LANES == 1
  const BlockPlace place = place_in_block(v, here, px, py, pz);
  const floatN value = value_in_block(v, &place);
#if INTERBLOCK
  run->value[k] = wanted && place.outside ? blend_blocks(v, here, px, py, pz, value, tally) : value;
#else
  run->value[k] = value;
#endif
#else
  const intN outside = place_fetch(v, &run->fetches[k], here, kind, px, py, pz);
#if INTERBLOCK
  queue_places(&run->queue, px, py, pz, k, outside & wanted);
#endif
#endif
  count_lanes(&tally[COUNT_BLOCK_READS], wanted);
}

INLINE void run_end(const BlockVolume *v, BlockRun *run, int places, Tally *tally)
{
#if LANES > 1
  int vectors = places;
#if INTERBLOCK
  PairQueue pairs;
  if (run->queue.count) vectors += queue_pairs(v, &run->queue, &pairs, run->fetches + places, tally);
#endif
  _Pragma("unroll 1") for (int k = 0; k < vectors; ++k)
    STORE_LANES(fetched_value(v, &run->fetches[k]), run->value + k * LANES);
#if INTERBLOCK
  if (run->queue.count) blend_pairs(&run->queue, &pairs, run->value + places * LANES);
#endif
#endif
}

INLINE floatN run_value(const BlockRun *run, int k)
{
  const floatN value = LOAD_LANES(run->value + k * LANES);
#if INTERBLOCK && LANES > 1
  return blended_value(&run->queue, k, value);
#else
  return value;
#endif
}

#endif
