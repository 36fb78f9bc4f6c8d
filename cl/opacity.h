/* Opacity of an optical depth. */
#ifndef OPACITY_H
#define OPACITY_H

#include "lanes.h"

/* 1 - exp(-x), x >= 0, to float precision also where x is tiny (Cody and Waite's reduction, a Taylor polynomial). */
INLINE floatN opacity_of_depth(floatN x)
{
  x = lane_min(x, (floatN)80.0f);
  const floatN n = floor(x * 1.44269504f + 0.5f);
  const floatN r = (n * 0.693359375f - x) + n * -2.12194440e-4f; /* n ln 2 - x */
  floatN p = 1.0f / 5040.0f;
  p = p * r + 1.0f / 720.0f, p = p * r + 1.0f / 120.0f, p = p * r + 1.0f / 24.0f;
  p = p * r + 1.0f / 6.0f, p = p * r + 0.5f;
  p = r + r * r * p; /* exp(r) - 1 */
  const floatN scale = AS_FLOAT((127 - TO_INT(n)) << 23);
  return (1.0f - scale) - scale * p;
}

#endif
