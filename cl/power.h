/* x^n for packets: exponents of highlights. PoCL's pow() works lane after lane. */
#ifndef POWER_H
#define POWER_H

#include "lanes.h"

/* log2 for normal x > 0: relative error below 2e-7 also next to x = 1, where a large exponent would show it. */
INLINE floatN lane_log2(floatN x)
{
  const intN bits = AS_INT(x);
  intN exponent = (bits >> 23) - 127;
  floatN m = AS_FLOAT((bits & 0x007fffff) | 0x3f800000); /* 1 .. 2 */
  const intN high = MASK(m > 1.41421356f);
  m = select(m, 0.5f * m, high), exponent -= high;
  const floatN s = (m - 1.0f) / (m + 1.0f), z = s * s;
  const floatN p = s * (2.88539008f + z * (0.961796694f + z * (0.577078016f + z * (0.412198583f + z * 0.320598898f))));
  return TO_FLOAT(exponent) + p;
}

/* 2^x for x <= 127; 0 below -126. */
INLINE floatN lane_exp2(floatN x)
{
  const intN vanishes = MASK(x < -126.0f);
  x = lane_clamp(x, (floatN)-126.0f, (floatN)127.0f);
  const floatN n = floor(x + 0.5f), r = (x - n) * 0.693147181f;
  floatN p = 1.0f / 5040.0f;
  p = p * r + 1.0f / 720.0f, p = p * r + 1.0f / 120.0f, p = p * r + 1.0f / 24.0f;
  p = p * r + 1.0f / 6.0f, p = p * r + 0.5f;
  p = 1.0f + (r + r * r * p);
  return select(p * AS_FLOAT((127 + TO_INT(n)) << 23), (floatN)0.0f, vanishes);
}

/* x in 0 .. 1, n >= 1; 0 where x is 0. */
INLINE floatN lane_power(floatN x, float n)
{
  const intN positive = MASK(x > 1e-30f);
  return select((floatN)0.0f, lane_exp2(n * lane_log2(select((floatN)1.0f, x, positive))), positive);
}

#endif
