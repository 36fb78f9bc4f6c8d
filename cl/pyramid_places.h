/* Places on slices: fetched, sampled and asked of the oracle (oracle.h). */
#ifndef PYRAMID_PLACES_H
#define PYRAMID_PLACES_H

#include "oracle.h"
#include "pyramid.h"

#if BLOCKS

/* Blocks are found, sampled and blended all at once. */
typedef struct {
  floatN x, y, z;
  intN wanted, byte;
} FetchedPlace;

#define FETCHES_EARLY 0

INLINE FetchedPlace fetch_place(const Source *in, floatN x, floatN y, floatN z, intN wanted, int with_map)
{
  const FetchedPlace f = {x, y, z, wanted, ORACLE_HAS_MAP && with_map ? fetch_map(in, x, y, z) : (intN)0};
  return f;
}
INLINE floatN place_value(const Source *in, const FetchedPlace *f)
{
  return blocks_value(in->blocks, f->x, f->y, f->z, f->wanted, in->block_counters);
}

#else

/* A place is fetched, its value and what the oracle's map says, and then looked at: there may be other work to do
 * while memory answers. */
typedef struct {
  FetchedSample sample;
  intN byte;
} FetchedPlace;

/* Lanes that are not `wanted` all go to one place, which costs no memory traffic. */
INLINE FetchedPlace fetch_place(const Source *in, floatN x, floatN y, floatN z, intN wanted, int with_map)
{
  FetchedPlace f;
  const floatN zero = 0.0f;
  x = select(zero, x, wanted), y = select(zero, y, wanted), z = select(zero, z, wanted);
  f.sample = fetch_sample(in->volume, in->view, x, y, z);
  f.byte = ORACLE_HAS_MAP && with_map ? fetch_map(in, x, y, z) : (intN)0;
  return f;
}
INLINE floatN place_value(const Source *in, const FetchedPlace *f) { return sample_value(f->sample, in->view); }

#define FETCHES_EARLY FETCH_AHEAD

#endif

/* Never so long that nothing finite can be synthesised from it. */
#define LONGEST 1e6f
INLINE floatN asked_distance(const Source *in, floatN x, floatN y, floatN z, floatN value, intN byte, floatN left)
{
  const floatN mapped = ORACLE_HAS_MAP ? byte_distance(byte) : (floatN)0.0f;
  return lane_min(oracle_distance(in, x, y, z, value, mapped, left), (floatN)LONGEST);
}
INLINE floatN place_distance(const Source *in, const FetchedPlace *f, floatN x, floatN y, floatN z, floatN value,
                             floatN left)
{
  return asked_distance(in, x, y, z, value, f->byte, left);
}

#endif
