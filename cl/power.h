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

/* floor() of what an int holds. PoCL's takes ten instructions. */
INLINE floatN lane_floor(floatN x)
{
  const floatN whole = TO_FLOAT(TO_INT(x));
  return whole - select((floatN)0.0f, (floatN)1.0f, MASK(whole > x));
}

/* 2^x for x <= 127; 0 below -126. */
INLINE floatN lane_exp2(floatN x)
{
  const intN vanishes = MASK(x < -126.0f);
  x = lane_clamp(x, (floatN)-126.0f, (floatN)127.0f);
  const floatN n = lane_floor(x + 0.5f), r = (x - n) * 0.693147181f;
  floatN p = 1.0f / 5040.0f;
  p = p * r + 1.0f / 720.0f, p = p * r + 1.0f / 120.0f, p = p * r + 1.0f / 24.0f;
  p = p * r + 1.0f / 6.0f, p = p * r + 0.5f;
  p = 1.0f + (r + r * r * p);
  return select(p * AS_FLOAT((127 + TO_INT(n)) << 23), (floatN)0.0f, vanishes);
}

/* Powers below 2^LEAST_POWER are 0: of what they are multiplied by, much would be denormal, for which processors take a
 * hundred times as long. */
#define LEAST_POWER -100.0f

/* x in 0 .. 1, n >= 1; 0 where x is 0. */
INLINE floatN lane_power(floatN x, float n)
{
  const intN positive = MASK(x > 1e-30f);
  const floatN y = n * lane_log2(select((floatN)1.0f, x, positive));
  return select((floatN)0.0f, lane_exp2(y), positive & MASK(y >= LEAST_POWER));
}

/* Of two, at the same time: each step waits for the one before, so that one alone takes as long as both. The same
 * operations in the same order as above. */
INLINE void lane_powers(floatN xa, floatN xb, float n, floatN *to_a, floatN *to_b)
{
#define STEP(P, X, C) P##a = P##a * X##a + C, P##b = P##b * X##b + C
  const intN la = MASK(xa > 1e-30f), lb = MASK(xb > 1e-30f);
  xa = select((floatN)1.0f, xa, la), xb = select((floatN)1.0f, xb, lb);
  const intN sa = AS_INT(xa) - 0x3f3504f3, sb = AS_INT(xb) - 0x3f3504f3;
  const intN ea = sa >> 23, eb = sb >> 23;
  const floatN fa = AS_FLOAT(AS_INT(xa) - (ea << 23)) - 1.0f, fb = AS_FLOAT(AS_INT(xb) - (eb << 23)) - 1.0f;
  floatN pa = 0.126148466f, pb = 0.126148466f;
  STEP(p, f, -0.207421035f), STEP(p, f, 0.215669859f), STEP(p, f, -0.23892034f), STEP(p, f, 0.287918324f);
  STEP(p, f, -0.360704828f), STEP(p, f, 0.48091061f), STEP(p, f, -0.721347333f), STEP(p, f, 1.442695f);
  floatN ya = n * (TO_FLOAT(ea) + fa * pa), yb = n * (TO_FLOAT(eb) + fb * pb);
  const intN va = MASK(ya < LEAST_POWER), vb = MASK(yb < LEAST_POWER);
  ya = lane_clamp(ya, (floatN)-126.0f, (floatN)127.0f), yb = lane_clamp(yb, (floatN)-126.0f, (floatN)127.0f);
  const floatN na = lane_floor(ya + 0.5f), nb = lane_floor(yb + 0.5f);
  const floatN ra = (ya - na) * 0.693147181f, rb = (yb - nb) * 0.693147181f;
  pa = pb = 1.0f / 5040.0f;
  STEP(p, r, 1.0f / 720.0f), STEP(p, r, 1.0f / 120.0f), STEP(p, r, 1.0f / 24.0f), STEP(p, r, 1.0f / 6.0f);
  STEP(p, r, 0.5f);
  pa = 1.0f + (ra + ra * ra * pa), pb = 1.0f + (rb + rb * rb * pb);
  pa = select(pa * AS_FLOAT((127 + TO_INT(na)) << 23), (floatN)0.0f, va);
  pb = select(pb * AS_FLOAT((127 + TO_INT(nb)) << 23), (floatN)0.0f, vb);
  *to_a = select((floatN)0.0f, pa, la), *to_b = select((floatN)0.0f, pb, lb);
#undef STEP
}

#endif
