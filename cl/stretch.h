/* What a stretch along which opacity and colour run linearly emits and absorbs, in closed form.
 *
 * Along a stretch, 1 - alpha runs linearly from q0 to q1; with m their mean and r = (q1 - q0) / (q1 + q0):
 *   mean of -log(1 - alpha)      -log m + S(r),   S = r^2 / 6 + r^4 / 20 + ... = 1 - ((1 + r) log(1 + r) - (1 - r)
 *                                log(1 - r)) / (2 r)
 *   its first moment             -M(r),           M = r / 6 + r^3 / 30 + ...   = (r - (1 - r^2) / 2 (log(1 + r) -
 *                                log(1 - r))) / (4 r^2)
 * (the moment about the middle, over lengths of the stretch). Both stay finite where alpha reaches 1 at one end, which
 * is why an opacity of 1 at one control point is no wall. The light that leaves a stretch comes, on average, from the
 * position
 *   1/2 - m - D / 12 + 3/5 m^2 D + m D^2 / 60 + D^3 / 720,   m = M / (mean),  D its optical depth:
 * a series in how thick the stretch is and how far its extinction is from constant; colour is linear, so that is where
 * it is taken. Beyond D = 1 it is the position under constant extinction, and what m adds in proportion:
 *   p + 6 m (2 p - 1) / D,   p = 1 + 1 / D - 1 / (1 - exp(-D)).
 * Where that is not enough for the colours of the stretch the position is integrated instead.
 */
#ifndef STRETCH_H
#define STRETCH_H

#include "lanes.h"
#include "opacity.h"

/* The optical depth of what is opaque at once: zero times it is zero, and any share of it that counts is opaque. */
#define OPAQUE_DEPTH 1e15f

typedef struct {
  floatN r, g, b, a; /* premultiplied */
  floatN depth;      /* -log(1 - a), which `a` forgets where it rounds to 1 */
#if LIT_AT_ENDS
  floatN place;      /* where along the segment, 0 .. 1, what is seen of it lies on average, times a */
#endif
} SegmentColor;

/* -log(q), where q = 1 - a is in 0 .. 1, to float precision also where a is tiny; OPAQUE_DEPTH for q = 0. */
INLINE floatN depth_of_clear(floatN q, floatN a)
{
  const intN shifted = AS_INT(q) - 0x3f400000; /* 3/4 */
  const intN exponent = shifted >> 23;
  const floatN m = AS_FLOAT(AS_INT(q) - (exponent << 23)); /* 3/4 .. 3/2 */
  const floatN t = select(m - 1.0f, -a, MASK(exponent == 0));
  floatN p = -0.0527572967f;
  p = p * t + 0.110125907f, p = p * t - 0.130752504f, p = p * t + 0.143716052f, p = p * t - 0.166475564f;
  p = p * t + 0.199971393f, p = p * t - 0.250001788f, p = p * t + 0.333333462f;
  p = t + t * t * (p * t - 0.5f);
  return select(-0.693147181f * TO_FLOAT(exponent) - p, (floatN)OPAQUE_DEPTH, MASK(q <= 0.0f));
}

/* S(r) and M(r) of the head of this file, for r in -1 .. 1. */
INLINE void spread_and_moment(floatN r, floatN *spread, floatN *moment)
{
  const floatN x = r * r;
  floatN s = 0.0143637899f, m = 0.00791397970f;
  s = s * x + 0.0126870628f, m = m * x + 0.00728464220f;
  s = s * x + 0.0239149313f, m = m * x + 0.0143428529f;
  s = s * x + 0.0499968641f, m = m * x + 0.0333316326f;
  s = s * x + 0.166666687f, m = m * x + 0.166666672f;
  s *= x, m *= r;
  const intN wide = MASK(x > 0.25f);
  if (any_lane(wide)) {
    const floatN size = select((floatN)1.0f, fabs(r), wide), clear = lane_max(1.0f - size, (floatN)0.0f);
    const floatN up = -depth_of_clear((1.0f + size) * 0.5f, 0.5f - 0.5f * size) + 0.693147181f; /* log(1 + r) */
    /* log(1 - r), whose factors vanish at 1 */
    const floatN down = select(-depth_of_clear(clear, size), (floatN)0.0f, MASK(clear <= 0.0f));
    const floatN rest = 0.5f * clear * (1.0f + size) * (up - down);
    const floatN inverse = lane_reciprocal(size);
    const floatN all = (size - rest) * inverse * inverse * 0.25f;
    s = select(s, 1.0f - 0.5f * ((1.0f + size) * up - clear * down) * inverse, wide);
    m = select(m, select(all, -all, MASK(r < 0.0f)), wide);
  }
  *spread = s, *moment = m;
}

/* The same for |r| <= 1/3. */
INLINE void spread_and_moment_of_thin(floatN r, floatN *spread, floatN *moment)
{
  const floatN x = r * r;
  floatN s = 0.0161565486f, m = 0.00919363182f;
  s = s * x + 0.0236460138f, m = m * x + 0.0141951293f;
  s = s * x + 0.0500037037f, m = m * x + 0.0333353840f;
  s = s * x + 0.166666657f, m = m * x + 0.166666657f;
  *spread = s * x, *moment = m * r;
}

/* -log(1 - a) for a in 0 .. 1/2. */
INLINE floatN depth_of_thin(floatN a)
{
  floatN p = 1.44252288f;
  p = p * a - 1.69866586f, p = p * a + 1.26001048f, p = p * a - 0.204539746f, p = p * a + 0.269869834f;
  p = p * a + 0.242774457f, p = p * a + 0.333702564f, p = p * a + 0.499992818f, p = p * a + 1.0f;
  return p * a;
}

/* Where along a stretch of optical depth D (at most 1; beyond it counts as 1) the light comes from, 0 .. 1; `moment`:
 * M / (mean of -log(1 - alpha)). */
INLINE floatN emission_position(floatN depth, floatN moment)
{
  depth = lane_min(depth, (floatN)1.0f);
  return 0.5f - moment - depth *
      (1.0f / 12.0f - 0.6f * moment * moment - depth * (moment * (1.0f / 60.0f) + depth * (1.0f / 720.0f)));
}

/* 1 - exp(-D), by a polynomial up to D = 1. */
INLINE floatN opacity_of_stretch(floatN depth)
{
  floatN p = -0.000913546712f;
  p = p * depth + 0.00783987436f, p = p * depth - 0.0414209664f, p = p * depth + 0.166610464f,
      p = p * depth - 0.499995261f;
  p = depth * (p * depth + 0.99999994f);
  const intN thick = MASK(depth > 1.0f);
  if (any_lane(thick)) p = select(p, opacity_of_depth(depth), thick);
  return p;
}

/* Appends a stretch of optical depth `depth` and colour (r, g, b) behind what `s` holds. */
INLINE void append_stretch(SegmentColor *s, floatN r, floatN g, floatN b, floatN depth)
{
  const floatN opacity = opacity_of_stretch(depth), share = opacity - s->a * opacity;
  s->r += share * r, s->g += share * g, s->b += share * b;
  s->a += share, s->depth += depth;
}

/* The same where `s` is empty. */
INLINE SegmentColor first_stretch(floatN r, floatN g, floatN b, floatN depth)
{
  const floatN opacity = opacity_of_stretch(depth);
  const SegmentColor s = {opacity * r, opacity * g, opacity * b, opacity, depth};
  return s;
}

/* Gauss's six points and weights in the square root of the position: dense at the front, where the light comes from. */
__constant float thick_position[6] = {0.00114009163f, 0.02869477f, 0.144925186f, 0.383544372f, 0.689904156f,
                                      0.933609606f};
__constant float thick_weight[6] = {0.0057848131f, 0.0611113173f, 0.178130346f, 0.289783588f, 0.299650256f,
                                    0.165539679f};

/* Lanes for which the series of emission_position() may not be enough. */
INLINE intN is_thick(floatN depth, floatN moment) { return MASK(depth > 1.0f) | MASK(depth * fabs(moment) > 0.08f); }

/* As emission_position() for these lanes (`thick`), for `units` opacity units along which 1 - alpha runs from q0 to q1,
 * alpha from a0 to a1, and colours change by up to `change`. Where they could be off by 1e-4 the position is integrated:
 * int (exp(-D(x)) - exp(-D)) dx / (1 - exp(-D)), to 1e-4 up to D = 8 and 3e-3 beyond. */
RARE floatN emission_position_of_thick(floatN q0, floatN q1, floatN a0, floatN a1, floatN units, floatN depth,
                                       floatN moment, floatN change, intN thick)
{
  const floatN one = 1.0f, least = 1e-30f;
#if LIT_AT_ENDS
  change = one; /* light may change by as much, whatever colours do */
#endif
  const intN deep = MASK(depth > one);
  floatN at = emission_position(depth, moment);
  if (any_lane(deep)) {
    const floatN d = lane_max(depth, one), inverse = lane_reciprocal(d);
    const floatN p = one + inverse - lane_reciprocal(opacity_of_depth(d));
    at = select(at, lane_max(p + 6.0f * moment * inverse * (2.0f * p - one), (floatN)0.0f), deep);
  }
  /* The former errs by up to 6 moment^2, the series by up to 0.01. */
  const intN inexact = thick & select(MASK(change > 0.01f), MASK(moment * moment * change > 1e-4f / 6.0f), deep);
  if (!any_lane(inexact)) return at;
  floatN whole = 0.0f, sum = 0.0f;
  _Pragma("unroll 1") for (int k = 0; k < 7; ++k) {
    const float x = k ? thick_position[k - 1] : 1.0f;
    const floatN turn = 0.5f * x * (q1 - q0), clear = q0 + turn;
    floatN spread, first;
    spread_and_moment(lane_clamp(turn * lane_reciprocal(lane_max(clear, least)), -one, one), &spread, &first);
    const floatN rate = depth_of_clear(clear, a0 + 0.5f * x * (a1 - a0)) + spread;
    const floatN opacity = opacity_of_depth(rate * units * x);
    if (k == 0)
      whole = opacity;
    else
      sum += thick_weight[k - 1] * (whole - opacity);
  }
  return select(at, sum * rough_reciprocal(lane_max(whole, least)), inexact);
}

#endif
