/* Between which depths a packet can see anything, before any of its rays is cast: rays side by side would leap over the
 * same empty space one by one.
 *
 * The rays of a packet lie in a frustum whose sides are linear in the depth behind the reference plane (view.h). It
 * leaps as a ray does (skip_empty.h), as long as it lies within the cube that is transparent: from the front to where
 * anything may come, and from the back to where nothing does any more. The frusta of LANES packets leap together, each
 * in a lane, so that a tile of 16 x 16 pixels takes as long as one ray. (Beams: Amanatides 1984. Where Klein et al., 2005,
 * take a ray's start from the frame before, spans need none.)
 *
 * A span is conservative: nothing that a ray of the packet meets outside of it is visible, so the picture does not
 * change by a bit.
 */
#ifndef PACKET_SPANS_H
#define PACKET_SPANS_H

#include "features.h"
#include "lanes.h"
#include "rays.h"
#include "skip_empty.h"
#include "tally.h"
#include "view.h"

/* Whether the march keeps to spans. Rays that see nothing may still see the environment, or be what is projected. */
#define SPANS                                                                              \
  (SKIP_EMPTY && LANES > 1 && !SLICES && QUADRATURE != QUADRATURE_CELLS &&      \
   (!EFFECTS || (!COMPOSITING && !ENVIRONMENT_VISIBLE)))

/* Depths of rays in edges behind the reference plane. from > to: the packet sees nothing. */
typedef struct {
  floatN from, to;
} Span;

INLINE Span span_between(floatN from, floatN to)
{
  Span span;
  span.from = from, span.to = to;
  return span;
}

INLINE Span whole_span(void) { return span_between(-(floatN)INFINITY, (floatN)INFINITY); }

/* Frusta whose next leap is shorter than this many edges stay where they are. */
#define LEAST_LEAP 1.0f

/* A lattice coordinate among the cells; see AMONG_CELLS in skip_empty.h. */
#if BLOCKS
#define SIDE_AMONG_CELLS(x) ((x) + 0.5f)
#else
#define SIDE_AMONG_CELLS(x) (x)
#endif

/* One pair of sides of the lanes' frusta: at depth s they lie at low + s low_slope and high + s high_slope, and with
 * the middle at place + s slope. */
typedef struct {
  floatN place, slope;
  floatN low, low_slope, low_inverse;
  floatN high, high_slope, high_inverse;
} Sides;

INLINE floatN signed_inverse(floatN x) { return 1.0f / select(x, (floatN)1e-20f, MASK(fabs(x) < 1e-20f)); }

/* u, v: of the packets' middles; half_u, half_v: from there to its last pixels. */
INLINE Sides sides_along(floatN u, floatN v, floatN half_u, floatN half_v, float origin, float du, float dv,
                         float forward, float ray_du, float ray_dv, float upper)
{
  Sides s;
  s.place = origin + u * du + v * dv, s.slope = forward + u * ray_du + v * ray_dv;
  /* Rounding of the rays' places, with a margin. */
  const floatN slack = 0.02f + 4e-6f * (upper + fabs(s.place));
  const floatN half_ = slack + (half_u * fabs(du) + half_v * fabs(dv));
  const floatN widens = half_u * fabs(ray_du) + half_v * fabs(ray_dv);
  s.low = s.place - half_, s.low_slope = s.slope - widens;
  s.high = s.place + half_, s.high_slope = s.slope + widens;
  s.low_inverse = signed_inverse(s.low_slope), s.high_inverse = signed_inverse(s.high_slope);
  return s;
}

/* Cuts [from, to] to where a + s slope >= 0. */
INLINE void cut_span(floatN a, floatN slope, floatN inverse, floatN *from, floatN *to)
{
  const floatN at = -a * inverse;
  const intN rises = MASK(slope > 1e-20f), falls = MASK(slope < -1e-20f);
  *from = select(*from, lane_max(at, *from), rises);
  *to = select(*to, lane_min(at, *to), falls);
  *to = select(*to, -(floatN)INFINITY, MASK(a < 0.0f) & ~rises & ~falls);
}

/* Where a + s slope falls below 0, if that is behind s; `inside` loses the lanes in which it is below 0 already. */
INLINE floatN falls_below(floatN a, floatN slope, floatN inverse, floatN s, intN *inside)
{
  *inside &= MASK(a + s * slope >= 0.0f);
  return select((floatN)INFINITY, -a * inverse, MASK(slope < -1e-20f));
}

/* Where the frusta leave the cells from `first` to before `end` of an axis with `cells`; what lies outside of the
 * volume does not matter. No side falls below `first` in lanes that are `ahead` of it. */
INLINE floatN leaves_cells(const Sides *sides, intN first, intN end, int cells, int shift, floatN s, intN ahead,
                           intN behind, intN *inside)
{
  const floatN infinite = INFINITY;
  const floatN low = select(TO_FLOAT(first << shift), -infinite, MASK(first <= 0) | ahead);
  const floatN high = select(TO_FLOAT(end << shift), infinite, MASK(end >= cells) | behind);
  const floatN a = falls_below(sides->low - low, sides->low_slope, sides->low_inverse, s, inside);
  const floatN b = falls_below(high - sides->high, -sides->high_slope, -sides->high_inverse, s, inside);
  return lane_min(a, b);
}

/* The cell of an axis from which the frusta leap at depth s: that of the side which lags, where all rays go to larger
 * (`ahead`) or all to smaller coordinates (`behind`), otherwise that of the middle. */
INLINE intN leaps_from(const Sides *sides, floatN s, float upper, int shift, intN last, intN ahead,
                       intN behind)
{
  const floatN place = select(select(sides->place, sides->high, behind), sides->low, ahead);
  const floatN slope = select(select(sides->slope, sides->high_slope, behind), sides->low_slope, ahead);
  return min(TO_INT(lane_clamp(place + s * slope, (floatN)0.0f, (floatN)upper)) >> shift, last);
}

/* From s on, at most to `end`: the depth before which the frusta see nothing, or beyond `end` if they never do. */
INLINE floatN span_leaps(__global const uchar *distances, __constant const View *view, const Sides *sides, floatN s,
                         floatN end, Tally *counted)
{
  const int shift = view->cell_shift;
  const intN zero = 0, last_x = view->cells.x - 1, last_y = view->cells.y - 1, last_z = view->cells.z - 1;
  intN active = MASK(s < end);
  /* Frusta all of whose rays are of one octant leap by its map: from the corner of their cells at which they lag, as
   * far as the cube ahead of that corner goes. */
  intN ahead[3], behind[3], octant = 0, one = (intN)(view->octant_cells > 0 ? -1 : 0);
  for (int k = 0; k < 3; ++k) {
    ahead[k] = MASK(lane_min(sides[k].low_slope, sides[k].high_slope) >= 0.0f);
    behind[k] = MASK(lane_max(sides[k].low_slope, sides[k].high_slope) <= 0.0f) & ~ahead[k];
    one &= ahead[k] | behind[k], octant |= ahead[k] & (1 << k);
  }
  for (int k = 0; k < 3; ++k) ahead[k] &= one, behind[k] &= one;
  const intN own = (octant + 1) * view->octant_cells & one;
  _Pragma("unroll 1") while (any_lane(active)) {
    COUNT_LEAP(counted, active)
    const floatN at = select((floatN)0.0f, s, active);
    const intN cx = leaps_from(&sides[0], at, view->upper.x, shift, last_x, ahead[0], behind[0]);
    const intN cy = leaps_from(&sides[1], at, view->upper.y, shift, last_y, ahead[1], behind[1]);
    const intN cz = leaps_from(&sides[2], at, view->upper.z, shift, last_z, ahead[2], behind[2]);
    const intN D = AS_INT(gather1(distances, own + ((cz * view->cells.y + cy) * view->cells.x + cx)) & 255u);
    active &= MASK(D > zero);
    const floatN x = leaves_cells(&sides[0], cx - D + 1, cx + D, view->cells.x, shift, at, ahead[0], behind[0], &active);
    const floatN y = leaves_cells(&sides[1], cy - D + 1, cy + D, view->cells.y, shift, at, ahead[1], behind[1], &active);
    const floatN z = leaves_cells(&sides[2], cz - D + 1, cz + D, view->cells.z, shift, at, ahead[2], behind[2], &active);
    const floatN leave = lane_min(lane_min(x, y), z);
    active &= MASK(leave >= at + LEAST_LEAP);
    s = select(s, leave, active);
    active &= MASK(s < end);
  }
  return s;
}

/* The spans of packets whose middles are u, v pixels from the middle of the picture, and whose last pixels are half_u,
 * half_v from there: floats [LANES]. Where view->deepest is 0 they are whole. */
RARE void frustum_spans(__global const uchar *distances, __constant const View *view, floatN u, floatN v,
                        floatN half_u, floatN half_v, float *from, float *to, Tally *counted)
{
  Sides sides[3];
  if (view->deepest <= 0.0f) {
    EACH_LANE(k) from[k] = -INFINITY, to[k] = INFINITY;
    return;
  }
#define SIDES_ALONG(k, c)                                                                                          \
  sides[k] = sides_along(u, v, half_u, half_v, SIDE_AMONG_CELLS(view->plane_origin.c), view->plane_du.c,           \
                         view->plane_dv.c, view->ray_forward.c, view->ray_du.c, view->ray_dv.c, view->upper.c)
  SIDES_ALONG(0, x);
  SIDES_ALONG(1, y);
  SIDES_ALONG(2, z);
  floatN enter = -fmin(view->plane_distance, 1.0f), leave = view->deepest;
  const float upper[3] = {SIDE_AMONG_CELLS(view->upper.x), SIDE_AMONG_CELLS(view->upper.y),
                          SIDE_AMONG_CELLS(view->upper.z)};
  for (int k = 0; k < 3; ++k) {
    cut_span(sides[k].high, sides[k].high_slope, sides[k].high_inverse, &enter, &leave);
    cut_span(upper[k] - sides[k].low, -sides[k].low_slope, -sides[k].low_inverse, &enter, &leave);
  }
  const floatN seen = span_leaps(distances, view, sides, enter, leave, counted);
  /* Backwards from the end: all slopes change sign. */
  for (int k = 0; k < 3; ++k) {
    sides[k].slope = -sides[k].slope;
    sides[k].low_slope = -sides[k].low_slope, sides[k].low_inverse = -sides[k].low_inverse;
    sides[k].high_slope = -sides[k].high_slope, sides[k].high_inverse = -sides[k].high_inverse;
  }
  const intN sees = MASK(seen < leave);
  const floatN back = -span_leaps(distances, view, sides, select((floatN)INFINITY, -leave, sees), -seen, counted);
  const floatN margin = 0.05f + 1e-6f * fabs(leave);
  STORE_LANES(select((floatN)INFINITY, seen - margin, sees), from);
  STORE_LANES(select(-(floatN)INFINITY, back + margin, sees), to);
}

/* Those of the packets whose first pixels are (column, row). */
INLINE void packet_spans(__global const uchar *distances, __constant const View *view, intN column, intN row,
                         float *from, float *to, Tally *counted)
{
  const float half_u = 0.5f * (PACKET_W - 1), half_v = 0.5f * (PACKET_H - 1);
  const floatN u = TO_FLOAT(column) + (half_u - view->centre.x), v = TO_FLOAT(row) + (half_v - view->centre.y);
  frustum_spans(distances, view, u, v, (floatN)half_u, (floatN)half_v, from, to, counted);
}

/* A span along rays, in steps of h edges from their entries: before `from` and from `to` on nothing is visible. */
INLINE void span_along(__constant const View *view, Span span, const Rays *ray, floatN column, floatN row, float h,
                       floatN *from, floatN *to)
{
  const floatN a = (column - view->centre.x) * view->tangent.x, b = (row - view->centre.y) * view->tangent.y;
  const floatN slant = sqrt(1.0f + a * a + b * b), margin = 1e-6f * fabs(ray->entry_depth);
  const float per_edge = 1.0f / h;
  *from = ((span.from + view->plane_distance) * slant - ray->entry_depth - margin) * per_edge;
  *to = ((span.to + view->plane_distance) * slant - ray->entry_depth + margin) * per_edge;
}

#endif
