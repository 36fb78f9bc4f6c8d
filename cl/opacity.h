/* Opacity of an optical depth. */
#ifndef OPACITY_H
#define OPACITY_H

#include "lanes.h"
#include "power.h"

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

/* What share of its opacity a segment keeps that is `length` (0 .. 1) as long: (1 - (1 - opacity)^length) / opacity. */
INLINE floatN share_of_opacity(floatN opacity, floatN length)
{
  /* -log(1 - opacity); the series where 1 - opacity has lost the digits. */
  const intN thin = MASK(opacity < 0.03f);
  const floatN left = lane_max(1.0f - opacity, (floatN)1e-30f);
  const floatN series = opacity * (1.0f + opacity * (0.5f + opacity * (0.333333333f + opacity * 0.25f)));
  const floatN depth = select(-0.693147181f * lane_log2(left), series, thin);
  const intN none = MASK(opacity < 1e-30f);
  return select(opacity_of_depth(depth * length) / select(opacity, (floatN)1.0f, none), length, none);
}

#endif
