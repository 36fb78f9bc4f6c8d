/* Quadrature by cells: a ray is cut where it enters another lattice cell, and each piece is integrated by itself.
 *
 * Inside a cell the trilinear field along a ray is a cubic; at the faces it has kinks, and kinks are most of the error
 * of even steps once these are shorter than a voxel. Between the faces high order pays. The eight corners are fetched
 * once per cell, however often the field is evaluated in it (view->cell_parts parts per cell, 1 or an even number):
 *   post           two Gauss-Legendre points for every two parts; for one part the midpoint alone
 *   preintegrated  the chords between the ends of the parts, each shifted so that its mean is the cubic's (Simpson's
 *                  rule)
 */
#ifndef MARCH_CELLS_H
#define MARCH_CELLS_H

#include "classify.h"
#include "features.h"
#include "half_opacity.h"
#include "march.h"
#include "packet_spans.h"
#include "rays.h"
#include "sample_volume.h"
#include "scene.h"
#include "skip_empty.h"

#if FILTER != FILTER_LINEAR || CLASSIFICATION == CLASSIFICATION_PRE
#error "quadrature by cells needs the linear filter, and interpolated values that are classified"
#endif

INLINE floatN value_in_cell(const Corners *c, floatN x, floatN y, floatN z)
{
  const floatN v00 = mix_corners(c->v000, c->v100, x), v10 = mix_corners(c->v010, c->v110, x);
  const floatN v01 = mix_corners(c->v001, c->v101, x), v11 = mix_corners(c->v011, c->v111, x);
  return mix_corners(mix_corners(v00, v10, y), mix_corners(v01, v11, y), z);
}

INLINE floatN value_at(const Corners *c, const Rays *ray, floatN cx, floatN cy, floatN cz, floatN t)
{
  const floatN zero = 0.0f, one = 1.0f;
  return value_in_cell(c, lane_clamp(ray->x0 - cx + t * ray->dx, zero, one),
                       lane_clamp(ray->y0 - cy + t * ray->dy, zero, one),
                       lane_clamp(ray->z0 - cz + t * ray->dz, zero, one));
}

/* One cell's piece of the rays in `active`, from t0 to t1 (in steps). */
INLINE void integrate_cell(Gathered *acc, HalfOpacity *half_, const Corners *c, const Rays *ray, floatN cx, floatN cy,
                           floatN cz,
                           floatN t0, floatN t1, intN active, __global const float *table, __constant const View *view)
{
  const int parts = view->cell_parts;
  const floatN length = (t1 - t0) * (1.0f / (float)parts);
#if CLASSIFICATION == CLASSIFICATION_PREINTEGRATED
  floatN front = value_at(c, ray, cx, cy, cz, t0);
  _Pragma("unroll 1") for (int part = 0; part < parts; ++part) {
    const floatN start = t0 + length * (float)part;
    const floatN middle = value_at(c, ray, cx, cy, cz, start + 0.5f * length);
    const floatN back = value_at(c, ray, cx, cy, cz, start + length);
    /* The shift that gives the chord the cubic's mean, (front + 4 middle + back) / 6, kept within what is there. */
    const floatN shift = (2.0f * middle - front - back) * (1.0f / 3.0f);
    const floatN low = lane_min(lane_min(front, middle), back), high = lane_max(lane_max(front, middle), back);
    floatN first = lane_clamp(front + shift, low, high), second = lane_clamp(back + shift, low, high);
#if MAY_BE_NAN
    /* A corner that is not finite may have no weight in a face, and yet hide what is behind the face. */
    const intN bad = MASK((AS_INT(middle) & 0x7f800000) == 0x7f800000);
    first = select(first, middle, bad), second = select(second, middle, bad);
#endif
    if (may_be_visible(lane_min(first, second), lane_max(first, second), active, view)) {
      const floatN before = acc->a;
      composite_segment(acc, first, second, length, active, table, view);
      pass_opacity(acc, before, half_, start, start + length, first, second);
    }
    front = back;
  }
#else
  /* Of each pair of parts the first point lies at 0.42265 of the first part, the second at 0.57735 of the second. */
  const float inwards = parts > 1 ? 0.07735027f : 0.0f;
  const int alone = parts == 1;
  floatN before = acc->a; /* before both */
  _Pragma("unroll 1") for (int part = 0; part < parts; ++part) {
    const floatN t = t0 + length * ((float)part + (part & 1 ? 0.5f + inwards : 0.5f - inwards));
    const floatN value = value_at(c, ray, cx, cy, cz, t);
    if (!(part & 1)) before = acc->a;
    if (may_be_visible(value, value, active, view)) {
      const floatN between = acc->a;
      composite_value(acc, value, length, active, table, view);
#if WITH_DEPTH
      /* Only both points together are the rule. */
      const intN passes = passes_half(between, acc->a);
      if (any_lane(passes))
        note_half(half_, passes, before, t0 + length * (float)(part & ~1), length * (alone ? 1.0f : 2.0f), value,
                  value);
#endif
    }
  }
#endif
}

/* The packet's rays from cell to cell. `taken` counts evaluations of the field. */
PER_PACKET void render_packet(const Scene *scene, intN px, intN py, Span span, float *rgba, float *depth, uint *samples,
                          Tally *counted)
{
  __global const uchar *volume = scene->volume, *distances = scene->distances;
  __global const float *table = scene->table;
  __constant const View *view = scene->view;
  const Rays ray = make_rays(view, TO_FLOAT(px), TO_FLOAT(py));
  const intN zero = 0, last_x = view->size.x - 2, last_y = view->size.y - 2, last_z = view->size.z - 2;
  const intN right = MASK(ray.rx > 0.0f), down = MASK(ray.ry > 0.0f), away = MASK(ray.rz > 0.0f);
  const intN step_x = select((intN)-1, (intN)1, right), step_y = select((intN)-1, (intN)1, down);
  const intN step_z = select((intN)-1, (intN)1, away);
  const uint evaluations = CLASSIFICATION == CLASSIFICATION_POST ? (uint)view->cell_parts
      : 2u * (uint)view->cell_parts + 1u;
  intN active = MASK(ray.length > 0.0f) & MASK(px < view->image.x) & MASK(py < view->image.y);
  intN ix = zero, iy = zero, iz = zero, known = zero; /* cell; whether it is known */
  floatN t = 0.0f;
  uintN taken = 0;
  Gathered acc;
  gathered_clear(&acc);
  HalfOpacity half_ = no_half(); /* in steps */

  while (any_lane(active)) {
#if SKIP_EMPTY
    const floatN visible_at = next_visible(distances, view, t, ray.length, active, &ray, counted);
    active &= MASK(visible_at < ray.length); /* a ray that is done stays where it is: no lane computes with infinity */
    const intN leaps = active & MASK(visible_at > t);
    t = select(t, visible_at, leaps), known &= ~leaps;
#endif
    const floatN x = ray.x0 + t * ray.dx, y = ray.y0 + t * ray.dy, z = ray.z0 + t * ray.dz;
    ix = select(min(max(TO_INT(floor(x)), zero), last_x), ix, known);
    iy = select(min(max(TO_INT(floor(y)), zero), last_y), iy, known);
    iz = select(min(max(TO_INT(floor(z)), zero), last_z), iz, known);
    known = active;
    FetchedCorners ahead = fetch_corners(volume, view, ix, iy, iz);
    _Pragma("unroll 1") for (int step = 0; step < MARCH_STEPS; ++step) {
      const floatN cx = TO_FLOAT(ix), cy = TO_FLOAT(iy), cz = TO_FLOAT(iz);
      const floatN tx = (cx + select((floatN)0.0f, (floatN)1.0f, right) - ray.x0) * ray.rx + ray.px;
      const floatN ty = (cy + select((floatN)0.0f, (floatN)1.0f, down) - ray.y0) * ray.ry + ray.py;
      const floatN tz = (cz + select((floatN)0.0f, (floatN)1.0f, away) - ray.z0) * ray.rz + ray.pz;
      const floatN leave = lane_min(lane_min(tx, ty), tz);
      const floatN t1 = lane_max(lane_min(leave, ray.length), t);
      const FetchedCorners fetched = ahead;
      const intN here = active;
      /* At least one index moves on, or the ray ends: the march is finite. */
      const intN nx = ix + (step_x & MASK(tx <= leave)), ny = iy + (step_y & MASK(ty <= leave));
      const intN nz = iz + (step_z & MASK(tz <= leave));
      const intN inside = MASK(nx >= zero) & MASK(nx <= last_x) & MASK(ny >= zero) & MASK(ny <= last_y) &
          MASK(nz >= zero) &
                          MASK(nz <= last_z);
      active &= inside & MASK(t1 < ray.length);
      ix = select(ix, nx, active), iy = select(iy, ny, active), iz = select(iz, nz, active);
      ahead = fetch_corners(volume, view, ix, iy, iz);
      const Corners c = decode_corners(fetched, view);
      integrate_cell(&acc, &half_, &c, &ray, cx, cy, cz, t, t1, here, table, view);
      taken += AS_UINT(here) & evaluations;
      t = select(t, t1, here);
      active &= MASK(acc.a < view->stop_opacity);
    }
  }
  gathered_store(&acc, rgba);
#if WITH_DEPTH && MIDPOINTS
  const intN noted = MASK(half_.from < INFINITY);
  if (any_lane(noted)) {
    floatN values[3]; /* at the ends and in the middle: Gauss's points are not there */
    _Pragma("unroll 1") for (int k = 0; k < 3; ++k) {
      const floatN along = select((floatN)0.0f, half_.from + 0.5f * (float)k * half_.length, noted);
      const FetchedSample sample = fetch_sample(volume, view, ray.x0 + along * ray.dx, ray.y0 + along * ray.dy,
                                                ray.z0 + along * ray.dz);
      values[k] = sample_value(sample, view);
    }
    taken += AS_UINT(noted) & 3u;
    half_.front = half_.back = values[1];
    note_ends(&half_, depth_between(values[0], values[0], noted, (intN)0, table, view),
              depth_between(values[2], values[2], noted, (intN)0, table, view));
  }
#endif
#if WITH_DEPTH
  STORE_LANES((ray.entry_depth + half_place(&half_, 1.0f, table, view) * view->step) * view->edge_length, depth);
#endif
  STORE_LANES(taken, samples);
}

#endif
