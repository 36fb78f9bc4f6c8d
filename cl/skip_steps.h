/* Leaps over empty space of the marches that take whole steps from a ray's entry (march_plain.h, march_steps.h). */
#ifndef SKIP_STEPS_H
#define SKIP_STEPS_H

#include "classify.h"
#include "lanes.h"
#include "march.h"
#include "rays.h"
#include "skip_empty.h"
#include "tally.h"
#include "view.h"

/* Moves rays that have steps left, i <= last, from `from` (in steps, in the cells `cells`) to where something may be
 * visible before `end`; those that see nothing more are DONE. Returns which of them have leapt. */
INLINE intN leap_along(Cells cells, __global const uchar *distances, __constant const View *view, floatN from,
                       floatN end, const Rays *ray, intN *i, intN *last, Tally *counted)
{
  const intN goes_on = MASK(*i <= *last);
  const floatN visible_at = next_visible_from(cells, distances, view, from, end, goes_on, ray, counted);
  const floatN finite = lane_clamp(visible_at, (floatN)0.0f, TO_FLOAT(max(*last, (intN)0)) + 1.0f);
  const intN next = TO_INT(MIDPOINTS ? ceil(finite - 0.5f) : finite) - (MIDPOINTS ? 0 : 1);
  const intN leaps = goes_on & MASK(next > *i);
  *last = select(*last, (intN)DONE, goes_on & MASK(visible_at >= ray->length));
  *i = select(*i, next, leaps);
  return leaps;
}

#endif
