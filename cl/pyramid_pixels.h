/* Level 0 of a tile, the picture's pixels: a packet of them through the slices of a chunk at once, its state in
 * registers (cl/pyramid.h). */
#ifndef PYRAMID_PIXELS_H
#define PYRAMID_PIXELS_H

#include "classify.h"
#include "composite.h"
#include "features.h"
#include "half_opacity.h"
#include "pyramid_levels.h"
#include "pyramid_packet.h"
#if EFFECTS
#include "pyramid_light.h"
#endif
#if EFFECTS && ISOSURFACES
#include "pyramid_surfaces.h"
#endif

#if CLASSIFICATION != CLASSIFICATION_PREINTEGRATED
#error "segments of adaptive length are pre-integrated"
#endif

#if WITH_DEPTH
#define HALF_OF(packet) (&(packet)->half_)
#else
#define HALF_OF(packet) 0
#endif

/* The packet at (column, row) of the picture; returns whether any of its rays meets the volume. */
int prepare_packet(__constant const View *view, __constant const Pyramid *pyramid, PixelPacket *p, int column, int row)
{
  const intN px = column + (LANE_INDEX & (PACKET_W - 1)), py = row + LANE_INDEX / PACKET_W;
  SliceRays r = slice_rays(view, TO_FLOAT(px), TO_FLOAT(py), 1);
#if EFFECTS && ISOSURFACES
  const floatN hull = r.enter;
#endif
  const intN cut = clip_to_halves(&r, pyramid, view->step);
  const intN alive = r.hits & MASK(px < view->image.x) & MASK(py < view->image.y), none = ~(intN)0;
  const floatN zero = 0.0f;
  STORE_LANES(r.x0, p->x0), STORE_LANES(r.y0, p->y0), STORE_LANES(r.z0, p->z0);
  STORE_LANES(r.dx, p->dx), STORE_LANES(r.dy, p->dy), STORE_LANES(r.dz, p->dz);
  STORE_LANES(r.enter, p->enter), STORE_LANES(r.leave, p->leave);
  STORE_LANES(zero, p->distance), STORE_LANES(zero, p->opacity);
  STORE_LANES(zero, p->value1), STORE_LANES(zero, p->value2), STORE_LANES(zero, p->t1), STORE_LANES(zero, p->t2);
  STORE_LANES(none, p->first), STORE_LANES(none, p->second), STORE_LANES(alive, p->alive);
#if CUT_FACES
  STORE_LANES(cut, p->cut);
#endif
#if EFFECTS && ISOSURFACES
  begin_walk(view, p, px, py, &r, hull);
#endif
#if WITH_DEPTH
  p->half_ = no_half();
#endif
  for (int k = 0; k < 4 * LANES; ++k) p->rgba[k] = 0.0f;
#if HELD_LIGHT
  STORE_LANES(zero, p->r), STORE_LANES(zero, p->g), STORE_LANES(zero, p->b);
#endif
  return any_lane(alive);
}

/* The packet begins anew at slice k, before which nothing is visible. Returns whether any ray goes on until then. */
INLINE int restart_packet(PixelPacket *p, int k)
{
  const intN none = ~(intN)0, alive = LOAD_LANES(p->alive) & MASK(LOAD_LANES(p->leave) > (float)k);
  STORE_LANES(none, p->first), STORE_LANES(none, p->second), STORE_LANES(alive, p->alive);
  return any_lane(alive);
}

/* Slices `base` to `base` + `slices` - 1 of the packet at (column, row) of the tile. Returns whether any ray goes on.
 * `inside`: all of its rays are inside the volume on all of these slices. */
INLINE int march_slices(const Source *in, SHARED const Levels *m, PixelPacket *p, int column, int row, int base,
                        int slices, int inside,
                        __global const float *table, Tally *samples, Tally *counted)
{
  __constant const View *view = in->view;
  intN alive = LOAD_LANES(p->alive);
  const floatN enter = LOAD_LANES(p->enter), leave = LOAD_LANES(p->leave);
  const floatN x0 = LOAD_LANES(p->x0), y0 = LOAD_LANES(p->y0), z0 = LOAD_LANES(p->z0);
  const floatN dx = LOAD_LANES(p->dx), dy = LOAD_LANES(p->dy), dz = LOAD_LANES(p->dz);
  floatN distance = LOAD_LANES(p->distance), opacity = LOAD_LANES(p->opacity);
  floatN value1 = LOAD_LANES(p->value1), value2 = LOAD_LANES(p->value2), t1 = LOAD_LANES(p->t1), t2 = LOAD_LANES(p->t2);
  intN first = LOAD_LANES(p->first), second = LOAD_LANES(p->second);
  const floatN zero = 0.0f, one = 1.0f;
  const int most = in->pyramid->levels, more = in->pyramid->oversampling;
  const float h = view->step;
  Gathered acc;
  int shows = 0; /* whether `acc` is needed */
#if EFFECTS && ISOSURFACES
  look_ahead(in, p, alive, (float)(base + CHUNK), samples, counted);
  floatN surface = next_surface(in, p);
#endif
  /* A packet that was sampled on the last slice mostly is on the next ones: all of them are fetched at once, since a
   * fetch from beyond the first caches takes longer than all else about a sample. */
  FetchedPlace ahead[CHUNK];
  const int dense_lanes = popcount(lane_bits(alive & MASK(distance < 2.0f * h)));
  const int is_dense = FETCHES_EARLY && inside && slices == CHUNK && 2 * dense_lanes >= (int)popcount(lane_bits(alive));
  if (is_dense)
    _Pragma("unroll 1") for (int i = 0; i < CHUNK; ++i) {
      const float t = (float)(base + i);
      ahead[i] = fetch_place(in, x0 + t * dx, y0 + t * dy, z0 + t * dz, alive, 1);
    }
  int stride = 1; /* of slices: on none between does any ray take part */
  _Pragma("unroll 1") for (int i = 0; i < slices; i = (i & -stride) + stride) {
    const int k = base + i, along = slice_level(in, k);
    intN takes_part = alive;
    if (along < most) takes_part &= MASK(distance < (float)(2 << along) * h);
    /* Before a ray enters the volume only the slice counts from which on it might be asked for. */
    if (!inside) takes_part &= MASK(enter < (float)(k + (along < most ? 1 : 1 << most)));
    if (!any_lane(takes_part)) {
      stride = inside ? min(2 << along, 1 << most) : 1;
      continue;
    }
    stride = 1;
    const floatN t = inside ? (floatN)(float)k : lane_clamp((floatN)(float)k, enter, leave);
    intN sampled = takes_part;
    floatN value = zero;
    if (along + more > 0) {
      const int copy = m->copy[i];
      const floatN wanted = synthesised_pixels(m->distance1[copy], SIDE(1), column, row);
      distance = select(distance, wanted, takes_part);
      sampled &= MASK(distance < WITHIN * ray_spacing(in, k));
      if (any_lane(takes_part & ~sampled)) {
        value = synthesised_pixels(m->value1[copy], SIDE(1), column, row);
#if VOXEL_HOLES
        sampled |= takes_part & ~finite_lanes(value);
#endif
      }
      count_lanes(&counted[COUNT_SYNTHESES], takes_part);
    }
    if (any_lane(sampled)) {
      const floatN x = x0 + t * dx, y = y0 + t * dy, z = z0 + t * dz;
      const FetchedPlace fetched = is_dense ? ahead[i] : fetch_place(in, x, y, z, sampled, 1);
      value = select(value, place_value(in, &fetched), sampled);
      distance = select(distance, place_distance(in, &fetched, x, y, z, value, 1.0f - opacity), sampled);
      count_lanes(samples, sampled), count_lanes(&counted[COUNT_ORACLE_SAMPLES], sampled);
    }
    const floatN length = t - t1;
    intN closes = takes_part & ~first;
    if (!inside) closes &= MASK(length > 0.0f);
    const intN curved = closes & ~second;
    count_lanes(&counted[COUNT_ACCUMULATIONS], closes);
    intN uncut = closes; /* segments without a surface */
#if EFFECTS && ISOSURFACES
    const intN meets = closes & MASK(surface <= t);
    if (any_lane(meets)) {
      if (!shows) gathered_load(&acc, p->rgba);
      shows = 1, uncut &= ~meets;
      const LastSamples last = {value1, value2, t1, t2, curved};
      close_at_surfaces(in, p, &acc, &last, t, value, meets, table, samples, counted);
      opacity = acc.a;
      alive &= ~(meets & MASK(opacity >= view->stop_opacity));
      look_ahead(in, p, alive, (float)(base + CHUNK), samples, counted);
      surface = next_surface(in, p);
    }
#endif
    /* The segment's ends stay between the samples that it depends on: where all of these show nothing, no more is to
     * be done. */
    floatN low = lane_min(value1, value), high = lane_max(value1, value);
    /* not those of a hole */
    low = select(low, lane_min(value2, low), curved), high = select(high, lane_max(value2, high), curved);
    if (any_lane(uncut & MASK(high > in->pyramid->gate_low) & MASK(low < in->pyramid->gate_high))) {
      const floatN long_ = select(one, length, uncut);
      floatN front = value1, back = value;
      shift_uneven_ends(value2, &front, &back, select(one, t1 - t2, curved), long_, curved);
      if (may_be_visible(lane_min(front, back), lane_max(front, back), uncut, view)) {
#if HELD_LIGHT
        if (!shows) acc.r = acc.g = acc.b = 0.0f;
        acc.a = opacity;
#else
        if (!shows) gathered_load(&acc, p->rgba);
#endif
        shows = 1;
#if EFFECTS
        SegmentColor color = color_of_segment(front, back, long_ * view->step_units, uncut,
                                              scene_pieces(table, (intN)0, view));
        const floatN middle = t1 + 0.5f * long_;
#if HELD_LIGHT
        queue_lit(in, color, p, middle, &acc, uncut, EFFECT_TALLIES(counted));
#else
        const floatN depth = light_segment(in->scene, in->pyramid, &color, p, middle, 1.0f - acc.a, uncut,
                                           EFFECT_TALLIES(counted));
        composite_color(&acc, color, uncut);
#endif
#else
        composite_segment(&acc, front, back, long_, uncut, table, view);
#endif
        pass_opacity(&acc, opacity, HALF_OF(p), t1, t, front, back);
#if EFFECTS && HALF_SCALED && WITH_DEPTH
        note_whole(HALF_OF(p), passes_half(opacity, acc.a), depth, 0.0f);
#endif
        opacity = acc.a;
        alive &= ~(takes_part & MASK(opacity >= view->stop_opacity));
      }
    }
    value2 = select(value2, value1, closes), t2 = select(t2, t1, closes), second &= ~closes;
    value1 = select(value1, value, takes_part), t1 = select(t1, t, takes_part), first &= ~takes_part;
    if (!inside) alive &= ~(takes_part & MASK(t >= leave));
    if (!any_lane(alive)) break;
  }
  STORE_LANES(distance, p->distance);
  STORE_LANES(value1, p->value1), STORE_LANES(value2, p->value2), STORE_LANES(t1, p->t1), STORE_LANES(t2, p->t2);
  STORE_LANES(first, p->first), STORE_LANES(second, p->second), STORE_LANES(alive, p->alive);
  if (shows) {
#if !HELD_LIGHT
    gathered_store(&acc, p->rgba);
#elif CONSTANT_CELLS
    STORE_LANES(LOAD_LANES(p->r) + acc.r, p->r), STORE_LANES(LOAD_LANES(p->g) + acc.g, p->g);
    STORE_LANES(LOAD_LANES(p->b) + acc.b, p->b);
#endif
    STORE_LANES(opacity, p->opacity);
  }
  return any_lane(alive);
}

int march_inside(const Source *in, SHARED const Levels *m, PixelPacket *p, int column, int row, int base, int slices,
                 __global const float *table, Tally *samples, Tally *counted)
{
  return march_slices(in, m, p, column, row, base, slices, 1, table, samples, counted);
}

int march_packet(const Source *in, SHARED const Levels *m, PixelPacket *p, int column, int row, int base, int slices,
                 __global const float *table, Tally *samples, Tally *counted)
{
  const intN alive = LOAD_LANES(p->alive);
  if (!any_lane(alive)) return 0;
  /* On the last slice nothing may end: that is what the other way is for. */
  const intN cut = alive & (MASK(LOAD_LANES(p->enter) > (float)base) |
                            MASK(LOAD_LANES(p->leave) <= (float)(base + CHUNK)));
  if (!any_lane(cut)) return march_inside(in, m, p, column, row, base, slices, table, samples, counted);
  return march_slices(in, m, p, column, row, base, slices, 0, table, samples, counted);
}

#endif
