/* The oracle that this program has: oracle_distance(), how far samples around a place may be from each other.
 *
 *   floatN oracle_distance(const Source *in, floatN x, floatN y, floatN z, floatN value, floatN mapped, floatN left)
 *
 * x, y, z are a lattice place (not always inside the volume) and `value` that there; `mapped` is what the oracle's map
 * says of it, if there is one; `left` is the light that still arrives from there where that is known, else 1. The
 * result is a length in smallest voxel edges, 0 or more, never NaN. `in->pyramid->oracle` has the oracle's own
 * numbers, and `in->map` its own bytes. A header that does not look at `value` says so by ORACLE_NEEDS_VALUE 0: the
 * volume is then sampled less.
 */
#ifndef ORACLE_H
#define ORACLE_H

#include "features.h"
#include "lanes.h"
#include "oracle_layout.h"
#include "pyramid.h"

#define ORACLE_HAS_MAP (ORACLE == ORACLE_MAP || ORACLE == ORACLE_ERROR)

/* Bytes of a map: the float's exponent and the first four bits of its mantissa, 1/16 edge to 2^12 edges. The least one
 * stands for 0. */
INLINE floatN byte_distance(intN byte) { return select(AS_FLOAT((byte + ((127 - 4) << 4)) << 19), (floatN)0.0f,
                                                       MASK(byte == 0)); }

/* Where cells begin, in lattice units below 0: those of a volume of blocks are whole parts of these (blocks.h). */
#if BLOCKS
#define CELL_MARGIN 0.5f
#else
#define CELL_MARGIN 0.0f
#endif

/* The byte of the cell that holds a place inside the volume. `cells`: of the map along x, y, z, whose edge is 2^shift
 * lattice units. */
INLINE intN fetch_map_cell(__global const uchar *map, int4 cells, int shift, floatN x, floatN y, floatN z)
{
  const intN cx = min(TO_INT(x + CELL_MARGIN) >> shift, (intN)(cells.x - 1));
  const intN cy = min(TO_INT(y + CELL_MARGIN) >> shift, (intN)(cells.y - 1));
  const intN cz = min(TO_INT(z + CELL_MARGIN) >> shift, (intN)(cells.z - 1));
  return AS_INT(gather1(map, MAP_AT(cells, cx, cy, cz)) & 255u);
}

/* That of the oracle's map; outside the volume that of the nearest cell. */
INLINE intN fetch_map(const Source *in, floatN x, floatN y, floatN z)
{
  const float4 upper = in->view->upper;
  const floatN zero = 0.0f;
  return fetch_map_cell(in->map, in->pyramid->cells, in->pyramid->cell_shift, lane_clamp(x, zero, (floatN)upper.x),
                    lane_clamp(y, zero, (floatN)upper.y), lane_clamp(z, zero, (floatN)upper.z));
}

#if ORACLE == ORACLE_MINIMUM
#include "oracle_minimum.h"
#elif ORACLE == ORACLE_MAP
#include "oracle_map.h"
#elif ORACLE == ORACLE_ERROR
#include "oracle_error.h"
#else
#include "oracle_custom.h" /* found in the folder of the oracle's author */
#endif
#ifndef ORACLE_NEEDS_VALUE
#define ORACLE_NEEDS_VALUE 1
#endif

#endif
