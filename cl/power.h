/* x^n for packets: exponents of highlights. PoCL's pow() works lane after lane. */
#ifndef POWER_H
#define POWER_H

#include "lanes.h"

/* log2 for normal x > 0: relative error below 2e-7 also next to x = 1, where a large exponent would show it. No
 * division: a polynomial in f = m - 1 for the mantissa m in sqrt(1/2) .. sqrt(2) (Chebyshev's points), times f. */
INLINE floatN lane_log2(floatN x)
{
  const intN shifted = AS_INT(x) - 0x3f3504f3; /* sqrt(1/2) */
  const intN exponent = shifted >> 23;
  const floatN f = AS_FLOAT(AS_INT(x) - (exponent << 23)) - 1.0f;
  floatN p = 0.126148466f;
  p = p * f - 0.207421035f, p = p * f + 0.215669859f, p = p * f - 0.23892034f, p = p * f + 0.287918324f;
  p = p * f - 0.360704828f, p = p * f + 0.48091061f, p = p * f - 0.721347333f, p = p * f + 1.442695f;
  return TO_FLOAT(exponent) + f * p;
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

/* Of two, a step of one beside the same step of the other: each step waits for the one before. */
INLINE void lane_powers(floatN a, floatN b, float n, floatN *to_a, floatN *to_b)
{
  *to_a = lane_power(a, n), *to_b = lane_power(b, n);
}

#endif
