/* What the gradient decides about a segment: factors on its extinction by the gradient's magnitude, by the
 * derivative along the ray, and by hairs that grow along it; and emission and extinction from a function of value and
 * magnitude (Engel and Ertl 2002, section 5).
 *
 * Tables in `factors` are two rows of `n` floats: places ascending (per edge; of two at one place the later one holds
 * there), and factors at them, linear in between. Of the layers of a function of two values only the places are there:
 * their look-up tables lie one behind the other in `table`.
 */
#ifndef OPACITY_FACTORS_H
#define OPACITY_FACTORS_H

#include "effects.h"
#include "emission.h"
#include "features.h"
#include "scene.h"

/* Without over- or underflow of the squares. */
INLINE floatN length3(Vectors a)
{
  const floatN largest = lane_max(lane_max(fabs(a.x), fabs(a.y)), fabs(a.z));
  const floatN unit = lane_max(largest, (floatN)1e-37f);
  const Vectors scaled = {a.x / unit, a.y / unit, a.z / unit};
  return select((floatN)0.0f, unit * sqrt(dot3(scaled, scaled)), MASK(largest > 1e-37f));
}

typedef struct {
  intN low, high; /* entries */
  floatN share;   /* of the second */
  intN next_row;    /* of joint functions of three values: how far on the same two of the next row begin, */
  floatN row_share; /* and the share of that row */
} TablePlace;

/* Between which of `n` ascending places x lies; beyond the ends the outermost one twice. */
INLINE TablePlace place_in_table(__global const float *places, int n, floatN x)
{
  const intN zero = 0, last = n - 1;
  intN above = 0; /* places <= x */
  int stride = 1;
  while (2 * stride <= n) stride *= 2;
  _Pragma("unroll 1") for (; stride > 0; stride >>= 1) {
    const intN next = above + stride;
    const floatN place = AS_FLOAT(gather4(places, min(next, (intN)n) - 1));
    above = select(above, next, MASK(next <= n) & MASK(place <= x));
  }
  TablePlace p;
  p.low = max(above - 1, zero), p.high = min(above, last);
  const floatN from = AS_FLOAT(gather4(places, p.low)), to = AS_FLOAT(gather4(places, p.high)), span = to - from;
  const intN wide = MASK(span > 0.0f);
  p.next_row = 0, p.row_share = 0.0f;
  p.share = select((floatN)0.0f,
                   lane_clamp((x - from) / select((floatN)1.0f, span, wide), (floatN)0.0f, (floatN)1.0f), wide);
  return p;
}

#if OPACITY_FACTORS

/* The factor at x of the table of `n` points that begins at `offset`. */
INLINE floatN opacity_factor(const Scene *scene, int offset, int n, floatN x)
{
  __global const float *places = scene->factors + offset;
  const TablePlace p = place_in_table(places, n, x);
  const floatN low = AS_FLOAT(gather4(places + n, p.low)), high = AS_FLOAT(gather4(places + n, p.high));
  return low + p.share * (high - low);
}

/* e times the factors for a gradient (local, per edge) on a ray in the unit direction `forward` (local). */
INLINE void weigh_by_gradient(const Scene *scene, Emission *e, Vectors gradient, Vectors forward)
{
  __constant const Effects *effects = scene->effects;
  floatN factor = 1.0f;
#if OPACITY_FACTORS & OPACITY_FACTOR_GRADIENT
  factor *= opacity_factor(scene, effects->gradient_opacity_table, effects->gradient_opacity_points, length3(gradient));
#endif
#if OPACITY_FACTORS & OPACITY_FACTOR_DIRECTIONAL
  factor *= opacity_factor(scene, effects->directional_opacity_table, effects->directional_opacity_points,
                           fabs(dot3(gradient, forward)));
#endif
  e->r *= factor, e->g *= factor, e->b *= factor, e->d *= factor;
}

#if OPACITY_FACTORS & OPACITY_FACTOR_FUR
#define LONGEST_HAIR 32.0f /* edges from a sample to its root, at most */
#define LONGEST_SHARE 1e6f

/* e times the factors of fur at a lattice place of this value and gradient (local, per edge). A hair is as long as noise
 * says at its root: where the value would be the root's if it changed evenly along the gradient. So noise, and with it
 * the hair, is the same all along the gradient. A place without a gradient, or a value, is its own root. */
INLINE void weigh_by_fur(const Scene *scene, Emission *e, Vectors gradient, Vectors place, floatN value)
{
  __constant const Effects *effects = scene->effects;
  __constant const NoiseTerm *terms =
      effects->noise_terms + effects->added_terms + effects->moving_terms + effects->tinting_terms;
  const Vectors way = direction_to_lattice(effects, unit3(gradient));
  const floatN slope = lane_max(length3(gradient), (floatN)1e-30f);
  const floatN zero = 0.0f, one = 1.0f, longest = LONGEST_HAIR;
  floatN factor = 1.0f;
  _Pragma("unroll 1") for (int k = 0; k < effects->fur_terms; ++k) {
    __constant const NoiseTerm *term = terms + k;
    const floatN above = term->amplitude.x - value, away = select(zero, above, finite_lanes(above));
    const floatN height = lane_clamp(away * term->amplitude.y, zero, (floatN)LONGEST_SHARE); /* 1 at the tip */
    const Vectors root = sum3(place, scaled3(way, lane_clamp(away / slope, -longest, longest)));
    const floatN sum = fractal_noise_value(scene->noise, term, root.x * term->scale.x, root.y * term->scale.y,
                                           root.z * term->scale.z);
    const floatN hair = 0.5f + 0.5f * lane_clamp(sum, -one, one);
    factor *= lane_clamp(1.0f - term->value_amplitude * (height - hair), zero, one);
  }
  e->r *= factor, e->g *= factor, e->b *= factor, e->d *= factor;
}
#endif

#endif

#if TRANSFER_LAYERS

/* The two layers' tables that a gradient's magnitude lies between, of `floats` each, as floats from the beginning of
 * the first. */
INLINE TablePlace layers_around(const Scene *scene, Vectors gradient, int floats)
{
  __constant const Effects *effects = scene->effects;
  TablePlace p = place_in_table(scene->factors + effects->layer_table, effects->layer_count, length3(gradient));
  p.low *= floats, p.high *= floats;
  return p;
}

/* How many layers are around a place, and where the table of one of them begins. */
#define LAYER_CORNERS (TRANSFER_LAYERS == LAYERS_OF_THREE ? 4 : 2)
INLINE intN layer_corner(TablePlace p, int k)
{
  const intN first = k & 1 ? p.high : p.low;
  return k & 2 ? first + p.next_row : first;
}

INLINE Emission mixed_emission(Emission a, Emission b, floatN share)
{
  const Emission e = {a.r + share * (b.r - a.r), a.g + share * (b.g - a.g), a.b + share * (b.b - a.b),
                      a.d + share * (b.d - a.d)};
  return e;
}

#endif

#endif
