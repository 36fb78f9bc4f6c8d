/* Counting lanes: one number per lane, summed when a kernel ends. A sum over lanes at every count would cost. */
#ifndef TALLY_H
#define TALLY_H

#include "lanes.h"

/* For measurements: look-ups in the map of empty space are the only counter (skip_empty.h). */
#ifndef COUNT_LEAPS
#define COUNT_LEAPS 0
#endif

typedef uintN Tally;

/* One more for each lane of the mask. */
INLINE void count_lanes(Tally *tally, intN mask) { *tally -= AS_UINT(mask); }

INLINE uint tally_sum(Tally tally)
{
  uint each[LANES], sum = 0;
  STORE_LANES(tally, each);
  EACH_LANE(k) sum += each[k];
  return sum;
}

#endif
