/* The oracle of a bounded error of what a ray shows: the map is of the distance at which a segment is wrong by
 * epsilon. What less light arrives from may be wrong by more: errors of interpolation grow with the square of the
 * distance. */
#ifndef ORACLE_ERROR_H
#define ORACLE_ERROR_H

#include "lanes.h"
#include "pyramid.h"

#define ORACLE_NEEDS_VALUE 0

INLINE floatN oracle_distance(const Source *in, floatN x, floatN y, floatN z, floatN value, floatN mapped, floatN left)
{
  /* Not less than 1 by rounding: distances are often just at a bound. */
  return mapped * lane_max(lane_rsqrt(lane_max(left, (floatN)in->pyramid->oracle.x)), (floatN)1.0f);
}

#endif
