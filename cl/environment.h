/* Environment maps: the radiance of a direction from a map stored by octahedron (clvol/device/environment.py).
 *
 * The octahedron |x| + |y| + |z| = 1 is unfolded on a square, +y in its middle, -y at its four corners, the equator on
 * the lines |u| + |v| = 1. Nodes lie on the square's edges too, those of one direction with one value: no look-up
 * needs a neighbour across an edge. Values are linear over triangles, half cells cut parallel to the equator's line.
 */
#ifndef ENVIRONMENT_H
#define ENVIRONMENT_H

#include "lanes.h"

/* Linear over a triangle: exactly its nodes' value where they are the same. */
INLINE floatN environment_linear(__global const float *values, intN corner, intN beside, intN beneath, floatN s,
                                 floatN t)
{
  const floatN at = AS_FLOAT(gather4(values, corner));
  return at + s * (AS_FLOAT(gather4(values, beside)) - at) + t * (AS_FLOAT(gather4(values, beneath)) - at);
}

/* The radiance in direction (x, y, z), of any length. map: the map's first node (r, g, b, 0) of size x size, size odd,
 * row after row. A direction of length 0, or one that is not a number, gives the value of some direction. */
INLINE void environment_look_up(__global const float4 *map, int size, floatN x, floatN y, floatN z,
                                floatN *r, floatN *g, floatN *b)
{
  const floatN zero = 0.0f, one = 1.0f;
  const floatN across = fabs(x), along = fabs(z);
  const floatN inverse = 1.0f / lane_max(across + fabs(y) + along, (floatN)1e-30f);
  const intN below = MASK(y < 0.0f);
  const floatN u = select(across * inverse, 1.0f - along * inverse, below);
  const floatN v = select(along * inverse, 1.0f - across * inverse, below);
  const int cells = (size - 1) / 2; /* from the middle to an edge */
  const floatN column = lane_clamp(u, zero, one) * (float)cells, row = lane_clamp(v, zero, one) * (float)cells;
  const intN i = TO_INT(lane_min(column, (floatN)(float)(cells - 1)));
  const intN j = TO_INT(lane_min(row, (floatN)(float)(cells - 1)));
  const floatN s = column - TO_FLOAT(i), t = row - TO_FLOAT(j);
  const intN outer = MASK(s + t > 1.0f);
  const floatN to_aside = select(s, 1.0f - t, outer), to_down = select(t, 1.0f - s, outer);
  /* In floats from here on. */
  const intN aside = select((intN)4, (intN)-4, MASK(x < 0.0f));
  const intN down = select((intN)(4 * size), (intN)(-4 * size), MASK(z < 0.0f));
  const intN node = 4 * cells * (size + 1) + i * aside + j * down;
  const intN corner = node + (outer & (aside + down)), beside = node + aside, beneath = node + down;
  __global const float *values = (__global const float *)map;
  *r = environment_linear(values, corner, beside, beneath, to_aside, to_down);
  *g = environment_linear(values + 1, corner, beside, beneath, to_aside, to_down);
  *b = environment_linear(values + 2, corner, beside, beneath, to_aside, to_down);
}

#endif
