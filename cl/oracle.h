/* The oracle that this program has: oracle_distance(), how far samples around a place may be from each other.
 *
 *   floatN oracle_distance(const Source *in, floatN x, floatN y, floatN z, floatN value, floatN left)
 *
 * x, y, z are a lattice place (not always inside the volume), `value` is that there, `left` the light that still arrives from there
 * where that is known, else 1. The result is a length in smallest voxel edges, 0 or more, never NaN. `in->pyramid->oracle` has the
 * oracle's own numbers, and `in->map` its own bytes.
 */
#ifndef ORACLE_H
#define ORACLE_H

#include "features.h"

#if ORACLE == ORACLE_MINIMUM
#include "oracle_minimum.h"
#elif ORACLE == ORACLE_MAP
#include "oracle_map.h"
#elif ORACLE == ORACLE_ERROR
#include "oracle_error.h"
#else
#include "oracle_custom.h" /* found in the folder of the oracle's author */
#endif

#endif
