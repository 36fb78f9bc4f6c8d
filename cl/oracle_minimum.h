/* The oracle that always wants full resolution: what the method costs where it saves nothing
 * (Kraus et al. 2007, tables 2 and 3, "min"). */
#ifndef ORACLE_MINIMUM_H
#define ORACLE_MINIMUM_H

#include "lanes.h"
#include "pyramid.h"

#define ORACLE_NEEDS_VALUE 0

INLINE floatN oracle_distance(const Source *in, floatN x, floatN y, floatN z, floatN value, floatN mapped, floatN left)
{
  return 0.0f;
}

#endif
