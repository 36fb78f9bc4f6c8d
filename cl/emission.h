/* What a segment emits and absorbs, one array a channel: effects change each channel by itself.
 *
 * Tables hold (colour times optical depth, optical depth) of a segment one step long; both scale with the length. Where nothing
 * changes what a segment absorbs (SEGMENT_OPACITIES) they hold (premultiplied colour, opacity) instead, which saves the exponential:
 * only the last, shorter segment of a stretch has to go back to its depth.
 */
#ifndef EMISSION_H
#define EMISSION_H

#include "classify.h"
#include "opacity.h"

typedef struct {
  floatN r, g, b, d; /* c D and D of a segment of one step; SEGMENT_OPACITIES: c a and a */
} Emission;

typedef struct {
  floatN r, g, b, a; /* premultiplied */
} Gathered;

INLINE Emission no_emission(void)
{
  Emission e;
  e.r = e.g = e.b = e.d = 0.0f;
  return e;
}

#if LANES == 16

/* Two rays' entries, (first node | second node) x (c D, D), weighted and summed over the nodes: four floats a ray. */
#define ENTRY_SUM(weights, entries) ((weights).s012389ab * (entries).s012389ab + (weights).s4567cdef * (entries).s4567cdef)

/* The sum that belongs to a pair's accumulator in EACH_PAIR. */
#define h_of(c) H_##c
#define H_c0 h0
#define H_c1 h1
#define H_c2 h2
#define H_c3 h3
#define H_c4 h4
#define H_c5 h5
#define H_c6 h6
#define H_c7 h7

/* To an array a channel. */
INLINE Emission emission_of_pairs(float8 h0, float8 h1, float8 h2, float8 h3, float8 h4, float8 h5, float8 h6, float8 h7)
{
  const float16 q0 = (float16)(h0, h1), q1 = (float16)(h2, h3), q2 = (float16)(h4, h5), q3 = (float16)(h6, h7);
  Emission e;
  e.r = (float16)(q0.s048c, q1.s048c, q2.s048c, q3.s048c);
  e.g = (float16)(q0.s159d, q1.s159d, q2.s159d, q3.s159d);
  e.b = (float16)(q0.s26ae, q1.s26ae, q2.s26ae, q3.s26ae);
  e.d = (float16)(q0.s37bf, q1.s37bf, q2.s37bf, q3.s37bf);
  return e;
}

#endif

/* ..._in: from tables that begin `first` floats into `table`, a lane's own. */

#if CLASSIFICATION == CLASSIFICATION_PREINTEGRATED

INLINE Emission segment_emission_in(ClassCoordinate front, ClassCoordinate back, intN first, __global const float *table,
                                    __constant const View *view)
{
  const intN at = first + table_row(front, back, view);
  const size_t row = 4 * (size_t)view->table.y;
  const floatN right = back.fraction, left = 1.0f - right;
#if LANES == 16
  int entry[16];
  vstore16(at, 0, entry);
  const float16 f = front.fraction;
  float8 h0, h1, h2, h3, h4, h5, h6, h7;
#define BILINEAR_SUM(c, k, ka, kb, weights)                                                                           \
  {                                                                                                                   \
    __global const float *a_ = table + entry[k], *b_ = table + entry[k + 1];                                          \
    const float16 low_ = (float16)(vload8(0, a_), vload8(0, b_));                                                     \
    const float16 high_ = (float16)(vload8(0, a_ + row), vload8(0, b_ + row));                                        \
    const float16 mixed_ = low_ + f.s##ka##ka##ka##ka##ka##ka##ka##ka##kb##kb##kb##kb##kb##kb##kb##kb * (high_ - low_); \
    const float16 weights_ = weights;                                                                                 \
    h_of(c) = ENTRY_SUM(weights_, mixed_);                                                                            \
  }
  EACH_PAIR(BILINEAR_SUM, left, right)
#undef BILINEAR_SUM
  return emission_of_pairs(h0, h1, h2, h3, h4, h5, h6, h7);
#else
  __global const float *a = table + at;
  const float8 low = vload8(0, a), high = vload8(0, a + row);
  const float8 r = low + front.fraction * (high - low);
  const float4 c = left * r.lo + right * r.hi;
  const Emission e = {c.x, c.y, c.z, c.w};
  return e;
#endif
}

INLINE Emission segment_emission(ClassCoordinate front, ClassCoordinate back, __global const float *table,
                                 __constant const View *view)
{
  return segment_emission_in(front, back, (intN)0, table, view);
}

#endif

/* Of a value, from a one-dimensional table: float4 [nodes + 2]. */
INLINE Emission value_emission_in(ClassCoordinate at, intN first, __global const float *table)
{
  const floatN right = at.fraction, left = 1.0f - right;
#if LANES == 16
  int entry[16];
  vstore16(first + at.node * 4, 0, entry);
  float8 h0, h1, h2, h3, h4, h5, h6, h7;
#define LINEAR_SUM(c, k, ka, kb, weights)                                                        \
  {                                                                                              \
    const float16 both_ = (float16)(vload8(0, table + entry[k]), vload8(0, table + entry[k + 1])); \
    const float16 weights_ = weights;                                                            \
    h_of(c) = ENTRY_SUM(weights_, both_);                                                        \
  }
  EACH_PAIR(LINEAR_SUM, left, right)
#undef LINEAR_SUM
  return emission_of_pairs(h0, h1, h2, h3, h4, h5, h6, h7);
#else
  const float8 r = vload8(0, table + first + at.node * 4);
  const float4 c = left * r.lo + right * r.hi;
  const Emission e = {c.x, c.y, c.z, c.w};
  return e;
#endif
}

INLINE Emission value_emission(ClassCoordinate at, __global const float *table) { return value_emission_in(at, (intN)0, table); }

#if CLASSIFICATION == CLASSIFICATION_PRE

INLINE Emission classified_emission_in(FetchedSample s, __constant const View *view, __global const float *warp,
                                       intN first, __global const float *table)
{
  float4 lanes[LANES];
  float r[LANES], g[LANES], b[LANES], d[LANES];
  classified_samples_in(s, view, warp, first, table, lanes);
  EACH_LANE_ROLLED(k) r[k] = lanes[k].x, g[k] = lanes[k].y, b[k] = lanes[k].z, d[k] = lanes[k].w;
  const Emission e = {LOAD_LANES(r), LOAD_LANES(g), LOAD_LANES(b), LOAD_LANES(d)};
  return e;
}

INLINE Emission classified_emission(FetchedSample s, __constant const View *view, __global const float *warp,
                                    __global const float *table)
{
  return classified_emission_in(s, view, warp, (intN)0, table);
}

#endif

/* acc += (1 - A) (c, 1) (1 - exp(-D length)) for the rays in `active`; length in steps, at most 1. */
INLINE void composite_emission(Gathered *acc, Emission e, floatN length, intN active)
{
  const floatN left = select((floatN)0.0f, 1.0f - acc->a, active);
#if SEGMENT_OPACITIES
  floatN part = left;
  if (any_lane(active & MASK(length < 1.0f))) part = left * select((floatN)1.0f, share_of_opacity(e.d, length), MASK(length < 1.0f));
  acc->r += part * e.r, acc->g += part * e.g, acc->b += part * e.b, acc->a += part * e.d;
#else
  const intN thin = MASK(e.d < 1e-30f);
  const floatN opacity = opacity_of_depth(e.d * length);
  const floatN weight = left * select(opacity / select(e.d, (floatN)1.0f, thin), length, thin);
  acc->r += weight * e.r, acc->g += weight * e.g, acc->b += weight * e.b;
  acc->a += left * opacity;
#endif
}

/* The opacity of a segment of one step. */
INLINE floatN segment_opacity(Emission e)
{
#if SEGMENT_OPACITIES
  return e.d;
#else
  return opacity_of_depth(e.d);
#endif
}

#endif
