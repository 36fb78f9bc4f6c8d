/* Vectors of three components, one of each per lane. */
#ifndef VECTORS_H
#define VECTORS_H

#include "lanes.h"

/* A packet of vectors. */
typedef struct {
  floatN x, y, z;
} Vectors;

INLINE floatN dot3(Vectors a, Vectors b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
INLINE Vectors scaled3(Vectors a, floatN s)
{
  const Vectors r = {a.x * s, a.y * s, a.z * s};
  return r;
}
INLINE Vectors sum3(Vectors a, Vectors b)
{
  const Vectors r = {a.x + b.x, a.y + b.y, a.z + b.z};
  return r;
}
INLINE Vectors select3(Vectors a, Vectors b, intN mask)
{
  const Vectors r = {select(a.x, b.x, mask), select(a.y, b.y, mask), select(a.z, b.z, mask)};
  return r;
}
INLINE Vectors broadcast3(float4 v)
{
  const Vectors r = {v.x, v.y, v.z};
  return r;
}
/* Times a length, of unit length before; 0 stays 0 (and so does what is too short to have a direction). */
INLINE Vectors directed3(Vectors a, float length)
{
  const floatN square = dot3(a, a);
  const intN long_enough = MASK(square > 1e-37f) & MASK(square < 1e38f);
  const floatN inverse = lane_rsqrt(select((floatN)1.0f, square, long_enough));
  return scaled3(a, select((floatN)0.0f, length * inverse, long_enough));
}
INLINE Vectors unit3(Vectors a) { return directed3(a, 1.0f); }

#endif
