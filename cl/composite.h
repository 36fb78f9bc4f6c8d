/* Front-to-back compositing of a packet's rays.
 *
 * Opacity is accumulated, not transmittance: A += (1 - A) a keeps the small opacities of thousands of nearly transparent
 * segments, where a product of numbers just below 1 loses them.
 *
 * In a packet of 16 two rays share a vector: (first half | second half | first half | second half), four channels each,
 * and a ray's colour is the sum of its two halves. So the four corners of a bilinear look-up need two vector loads a ray and
 * no shuffle: the halves are the two columns, and the weights of the columns are folded into the weight of the ray.
 */
#ifndef COMPOSITE_H
#define COMPOSITE_H

#if LANES == 16

typedef struct {
  float16 c0, c1, c2, c3, c4, c5, c6, c7;
} Accumulator;

INLINE void accumulator_clear(Accumulator *a) { a->c0 = a->c1 = a->c2 = a->c3 = a->c4 = a->c5 = a->c6 = a->c7 = 0.0f; }

INLINE float16 accumulated_opacity(const Accumulator *a)
{
  return (float16)(a->c0.s3b, a->c1.s3b, a->c2.s3b, a->c3.s3b, a->c4.s3b, a->c5.s3b, a->c6.s3b, a->c7.s3b) +
         (float16)(a->c0.s7f, a->c1.s7f, a->c2.s7f, a->c3.s7f, a->c4.s7f, a->c5.s7f, a->c6.s7f, a->c7.s7f);
}

/* The packet's colours, four floats a ray. */
INLINE void accumulator_store(const Accumulator *a, float *rgba)
{
  vstore8((float8)(a->c0.s0123 + a->c0.s4567, a->c0.s89ab + a->c0.scdef), 0, rgba);
  vstore8((float8)(a->c1.s0123 + a->c1.s4567, a->c1.s89ab + a->c1.scdef), 1, rgba);
  vstore8((float8)(a->c2.s0123 + a->c2.s4567, a->c2.s89ab + a->c2.scdef), 2, rgba);
  vstore8((float8)(a->c3.s0123 + a->c3.s4567, a->c3.s89ab + a->c3.scdef), 3, rgba);
  vstore8((float8)(a->c4.s0123 + a->c4.s4567, a->c4.s89ab + a->c4.scdef), 4, rgba);
  vstore8((float8)(a->c5.s0123 + a->c5.s4567, a->c5.s89ab + a->c5.scdef), 5, rgba);
  vstore8((float8)(a->c6.s0123 + a->c6.s4567, a->c6.s89ab + a->c6.scdef), 6, rgba);
  vstore8((float8)(a->c7.s0123 + a->c7.s4567, a->c7.s89ab + a->c7.scdef), 7, rgba);
}

/* For each pair of rays: GROUP(accumulator, first ray, its lane digit, second ray's digit, weights of both rays' two columns). */
#define EACH_PAIR(GROUP, left, right)                                                                              \
  {                                                                                                                \
    const float16 l_ = (left), r_ = (right);                                                                       \
    const float16 za_ = (float16)(l_.s0, r_.s0, l_.s1, r_.s1, l_.s2, r_.s2, l_.s3, r_.s3, l_.s4, r_.s4, l_.s5,     \
                                  r_.s5, l_.s6, r_.s6, l_.s7, r_.s7);                                              \
    const float16 zb_ = (float16)(l_.s8, r_.s8, l_.s9, r_.s9, l_.sa, r_.sa, l_.sb, r_.sb, l_.sc, r_.sc, l_.sd,     \
                                  r_.sd, l_.se, r_.se, l_.sf, r_.sf);                                              \
    GROUP(c0, 0, 0, 1, za_.s0000111122223333)                                                                      \
    GROUP(c1, 2, 2, 3, za_.s4444555566667777)                                                                      \
    GROUP(c2, 4, 4, 5, za_.s88889999aaaabbbb)                                                                      \
    GROUP(c3, 6, 6, 7, za_.sccccddddeeeeffff)                                                                      \
    GROUP(c4, 8, 8, 9, zb_.s0000111122223333)                                                                      \
    GROUP(c5, 10, a, b, zb_.s4444555566667777)                                                                     \
    GROUP(c6, 12, c, d, zb_.s88889999aaaabbbb)                                                                     \
    GROUP(c7, 14, e, f, zb_.sccccddddeeeeffff)                                                                     \
  }

#else

typedef struct {
  float4 c;
} Accumulator;

INLINE void accumulator_clear(Accumulator *a) { a->c = 0.0f; }
INLINE float accumulated_opacity(const Accumulator *a) { return a->c.w; }
INLINE void accumulator_store(const Accumulator *a, float *rgba) { vstore4(a->c, 0, rgba); }

#endif

/* One ray's premultiplied colour of one segment, weighted: for the rare last piece of each ray. */
INLINE void accumulate_lanes(Accumulator *a, const float4 *rgba)
{
#if LANES == 16
  const float4 zero = 0.0f;
  a->c0 += (float16)(rgba[0], zero, rgba[1], zero), a->c1 += (float16)(rgba[2], zero, rgba[3], zero);
  a->c2 += (float16)(rgba[4], zero, rgba[5], zero), a->c3 += (float16)(rgba[6], zero, rgba[7], zero);
  a->c4 += (float16)(rgba[8], zero, rgba[9], zero), a->c5 += (float16)(rgba[10], zero, rgba[11], zero);
  a->c6 += (float16)(rgba[12], zero, rgba[13], zero), a->c7 += (float16)(rgba[14], zero, rgba[15], zero);
#else
  a->c += rgba[0];
#endif
}

/* Opacity correction: the colour of a piece `ratio` (0 .. 1) as long as a segment of this mean colour and optical depth. */
INLINE float4 part_of_segment(float4 color_depth, float ratio)
{
  const float opacity = -expm1(-color_depth.w * ratio);
  return (float4)(color_depth.xyz * opacity, opacity);
}

#endif
