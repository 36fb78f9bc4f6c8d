/* Light on what the picture's pixels composite (pyramid_pixels.h): gradients in the middle of segments, of whatever length
 * these are, by the reconstruction that the ray caster has. None of them is synthesised: where samples are dense a picture
 * has the ray caster's light. Oracles know of light only what it makes of an error of colours; how much it changes along a
 * segment is not looked at (clvol/README.md, "Pyramid", has what that costs).
 *
 * In a chunk of slices few segments of a packet show, and light is a chain of operations that wait for each other
 * (lit_entries.h). So segments of all packets of a tile are queued, packed, where that is one instruction and nothing
 * changes what a segment absorbs (HELD_LIGHT): opacity does not depend on colour, and what a colour counts for is known
 * when its segment ends. Elsewhere they are lit one by one.
 */
#ifndef PYRAMID_LIGHT_H
#define PYRAMID_LIGHT_H

#include "composite.h"
#include "effects.h"
#include "features.h"
#include "lanes.h"
#include "opacity.h"
#include "pyramid.h"
#include "pyramid_packet.h"
#include "rays.h"
#include "scene.h"
#include "scene_value.h"
#include "transfer_pieces.h"
#include "vectors.h"
#if OPACITY_FACTORS
#include "opacity_factors.h"
#endif
#if ENVIRONMENT_VISIBLE
#include "background.h"
#endif

#if LIGHTING
#include "shade.h"
#include "shown_normal.h"
#endif
#if DEPTH_CUE
#include "depth_cue.h"
#endif

#define TOGETHER 4 /* vectors that are lit together */

/* A packet's rays as rays.h has them, from where they enter. */
INLINE Rays rays_of_packet(__constant const View *view, const PixelPacket *p)
{
  Rays r;
  const floatN enter = LOAD_LANES(p->enter);
  r.dx = LOAD_LANES(p->dx), r.dy = LOAD_LANES(p->dy), r.dz = LOAD_LANES(p->dz);
  r.x0 = LOAD_LANES(p->x0) + enter * r.dx, r.y0 = LOAD_LANES(p->y0) + enter * r.dy;
  r.z0 = LOAD_LANES(p->z0) + enter * r.dz;
  r.rx = finite_inverse(r.dx, &r.px), r.ry = finite_inverse(r.dy, &r.py), r.rz = finite_inverse(r.dz, &r.pz);
  r.length = INFINITY;
  r.entry_depth = view->plane_distance + enter * view->step;
  return r;
}

INLINE Vectors packet_forward(const Scene *scene, const Rays *ray)
{
  return unit3(direction_to_local(scene->effects, ray->dx, ray->dy, ray->dz));
}

/* Outwards of what is kept, where a clip cuts the ray before it enters; 0 elsewhere. */
INLINE Vectors packet_cut_normal(const Scene *scene, __constant const Pyramid *pyramid, const PixelPacket *p)
{
  Vectors normal = {0.0f, 0.0f, 0.0f};
#if CUT_FACES
  const intN cut = LOAD_LANES(p->cut);
  for (int j = 0; j < pyramid->half_count; ++j) {
    const float4 half_ = pyramid->halves[j];
    const Vectors inwards = gradient_to_local(scene->effects, half_.x, half_.y, half_.z);
    normal = select3(normal, scaled3(unit3(inwards), -1.0f), MASK(cut == j));
  }
#endif
  return normal;
}

#if HELD_LIGHT

/* Segments of any packets of the tile, one an entry, whose opacity is composited: what their colour counts for is in it. */
#define QUEUED_VECTORS 32
#define MOST_QUEUED (LANES * QUEUED_VECTORS)
#define QUEUE_ROOM (MOST_QUEUED + LANES) /* whole vectors are stored and loaded at any entry */
typedef struct LightQueue {
  int count, segments;
  uint lanes[MOST_QUEUED]; /* of a segment: those that have an entry, as bits, */
  int packet[MOST_QUEUED]; /* and the number of its packet */
  float x[QUEUE_ROOM], y[QUEUE_ROOM], z[QUEUE_ROOM];                /* the middle of the segment, lattice */
  float along_x[QUEUE_ROOM], along_y[QUEUE_ROOM], along_z[QUEUE_ROOM]; /* the ray's direction, local */
  float r[QUEUE_ROOM], g[QUEUE_ROOM], b[QUEUE_ROOM], opacity[QUEUE_ROOM];
#if DEPTH_CUE || CUT_FACES
  float way[QUEUE_ROOM]; /* edges from where the ray enters */
#endif
#if DEPTH_CUE
  float entry_depth[QUEUE_ROOM];
#endif
#if CUT_FACES
  float cut_x[QUEUE_ROOM], cut_y[QUEUE_ROOM], cut_z[QUEUE_ROOM];
#endif
} LightQueue;

/* Adds a segment to the queue, whose middle is on slice `middle`, of the lanes `lit`, whose colours count for `part`. */
INLINE void queue_segment(const Scene *scene, __constant const Pyramid *pyramid, LightQueue *queue, SegmentColor s,
                          const PixelPacket *p, int number, floatN middle, floatN part, intN lit)
{
  const uint bits = lane_bits(lit);
  const int at = queue->count;
  const floatN dx = LOAD_LANES(p->dx), dy = LOAD_LANES(p->dy), dz = LOAD_LANES(p->dz);
  queue->count = at + popcount(bits);
  queue->lanes[queue->segments] = bits, queue->packet[queue->segments++] = number;
  pack_lanes(LOAD_LANES(p->x0) + middle * dx, bits, queue->x + at);
  pack_lanes(LOAD_LANES(p->y0) + middle * dy, bits, queue->y + at);
  pack_lanes(LOAD_LANES(p->z0) + middle * dz, bits, queue->z + at);
  const float steps = 1.0f / scene->view->step;
  const Vectors forward = direction_to_local(scene->effects, dx * steps, dy * steps, dz * steps);
  pack_lanes(forward.x, bits, queue->along_x + at), pack_lanes(forward.y, bits, queue->along_y + at);
  pack_lanes(forward.z, bits, queue->along_z + at);
  pack_lanes(part * s.r, bits, queue->r + at), pack_lanes(part * s.g, bits, queue->g + at);
  pack_lanes(part * s.b, bits, queue->b + at), pack_lanes(part * s.a, bits, queue->opacity + at);
#if DEPTH_CUE || CUT_FACES
  const floatN enter = LOAD_LANES(p->enter);
  pack_lanes((middle - enter) * scene->view->step, bits, queue->way + at);
#endif
#if DEPTH_CUE
  pack_lanes(scene->view->plane_distance + enter * scene->view->step, bits, queue->entry_depth + at);
#endif
#if CUT_FACES
  const Vectors cut = packet_cut_normal(scene, pyramid, p);
  pack_lanes(cut.x, bits, queue->cut_x + at), pack_lanes(cut.y, bits, queue->cut_y + at);
  pack_lanes(cut.z, bits, queue->cut_z + at);
#endif
}

#if LIGHTING
/* The gradients at `count` vectors of places. */
INLINE void queued_gradients(const Scene *scene, const LightQueue *queue, int k, int count, Vectors *gradients)
{
#if GRADIENTS_IN_STAGES && FILTER == FILTER_LINEAR
  __constant const View *view = scene->view;
  GradientWords words[TOGETHER];
  intN corners[TOGETHER];
  uint beside = 0; /* vectors that have an entry at the volume's faces, as bits */
  const intN inner_x = view->size.x - 3, inner_y = view->size.y - 3, inner_z = view->size.z - 3;
  _Pragma("unroll 1") for (int j = 0; j < count; ++j) {
    const int at = k + LANES * j;
    const floatN x = LOAD_LANES(queue->x + at), y = LOAD_LANES(queue->y + at), z = LOAD_LANES(queue->z + at);
    const intN ix = TO_INT(x), iy = TO_INT(y), iz = TO_INT(z);
    const intN inside = MASK(ix >= 1) & MASK(ix <= inner_x) & MASK(iy >= 1) & MASK(iy <= inner_y) & MASK(iz >= 1) &
        MASK(iz <= inner_z);
    beside |= (uint)(any_lane(~inside) != 0) << j;
    /* There it is not used, but has to be fetched from somewhere. */
    corners[j] = select((intN)(view->slice_stride + view->row_stride + 1),
                        corner_offset(scene->volume, view, ix, iy, iz), inside);
    words[j].fx = x - TO_FLOAT(ix), words[j].fy = y - TO_FLOAT(iy), words[j].fz = z - TO_FLOAT(iz);
  }
  if (min(min(view->size.x, view->size.y), view->size.z) < 4) beside = ~0u;
  else
    _Pragma("unroll 1") for (int j = 0; j < count; ++j)
      fetch_gradient_words(scene->volume, view, corners[j], &words[j]);
  _Pragma("unroll 1") for (int j = 0; j < count; ++j) {
    const int at = k + LANES * j;
    if (beside >> j & 1u) {
      gradients[j] = scene_gradient(scene, LOAD_LANES(queue->x + at), LOAD_LANES(queue->y + at),
                                    LOAD_LANES(queue->z + at));
    } else {
      const Gradient g = gradient_of_words(words[j]);
      gradients[j] = gradient_to_local(scene->effects, g.x, g.y, g.z);
    }
  }
#else
  _Pragma("unroll 1") for (int j = 0; j < count; ++j) {
    const int at = k + LANES * j;
    gradients[j] = scene_gradient(scene, LOAD_LANES(queue->x + at), LOAD_LANES(queue->y + at),
                                  LOAD_LANES(queue->z + at));
  }
#endif
}
#endif

/* Lights all that is queued, and adds it to the pixels of `packets`. */
RARE void light_queue(const Scene *scene, LightQueue *queue, PixelPacket *packets, Tally *counted)
{
  const int entries = queue->count;
  if (!entries) return;
  const floatN zero = 0.0f;
  /* What is behind the last entry needs a place. */
  STORE_LANES(zero, queue->x + entries), STORE_LANES(zero, queue->y + entries), STORE_LANES(zero, queue->z + entries);
  STORE_LANES(zero, queue->opacity + entries);
  _Pragma("unroll 1") for (int k = 0; k < entries; k += LANES * TOGETHER) {
    const int count = min((entries - k + LANES - 1) / LANES, TOGETHER);
#if LIGHTING
    Vectors gradients[TOGETHER];
    queued_gradients(scene, queue, k, count, gradients);
#endif
    _Pragma("unroll 1") for (int j = 0; j < count; ++j) {
      const int at = k + LANES * j;
      const floatN opacity = LOAD_LANES(queue->opacity + at);
      Vectors color = {LOAD_LANES(queue->r + at), LOAD_LANES(queue->g + at), LOAD_LANES(queue->b + at)};
#if LIGHTING
      const Vectors place = {LOAD_LANES(queue->x + at), LOAD_LANES(queue->y + at), LOAD_LANES(queue->z + at)};
      const Vectors view = {-LOAD_LANES(queue->along_x + at), -LOAD_LANES(queue->along_y + at),
                            -LOAD_LANES(queue->along_z + at)};
      Vectors cut = {0.0f, 0.0f, 0.0f};
      floatN way = 0.0f;
#if CUT_FACES
      cut.x = LOAD_LANES(queue->cut_x + at), cut.y = LOAD_LANES(queue->cut_y + at);
      cut.z = LOAD_LANES(queue->cut_z + at), way = LOAD_LANES(queue->way + at);
#endif
      const Vectors normal = shown_normal(scene, gradients[j], cut, way);
      const intN lit = MASK(at + LANE_INDEX < entries) & MASK(dot3(normal, normal) > 0.5f);
      color = shaded_color(scene, color, opacity, place, normal, gradients[j], view, opacity, 0, lit, counted);
#endif
#if DEPTH_CUE
      color = cued_color(scene, color, opacity, LOAD_LANES(queue->entry_depth + at) + LOAD_LANES(queue->way + at));
#endif
      STORE_LANES(color.x, queue->r + at), STORE_LANES(color.y, queue->g + at), STORE_LANES(color.z, queue->b + at);
    }
  }
  int at = 0;
  _Pragma("unroll 1") for (int k = 0; k < queue->segments; ++k) {
    const uint bits = queue->lanes[k];
    PixelPacket *p = packets + queue->packet[k];
    STORE_LANES(LOAD_LANES(p->r) + unpack_lanes(queue->r + at, bits), p->r);
    STORE_LANES(LOAD_LANES(p->g) + unpack_lanes(queue->g + at, bits), p->g);
    STORE_LANES(LOAD_LANES(p->b) + unpack_lanes(queue->b + at, bits), p->b);
    at += popcount(bits);
  }
  queue->count = queue->segments = 0;
}

#if CONSTANT_CELLS
/* Where the field is constant: there is no gradient, and nothing to light. */
INLINE intN is_constant(const Scene *scene, const PixelPacket *p, floatN t)
{
  __constant const View *view = scene->view;
  const int shift = view->cell_shift;
  const floatN zero = 0.0f;
  const floatN x = LOAD_LANES(p->x0) + t * LOAD_LANES(p->dx), y = LOAD_LANES(p->y0) + t * LOAD_LANES(p->dy);
  const floatN z = LOAD_LANES(p->z0) + t * LOAD_LANES(p->dz);
  const intN cx = min(TO_INT(lane_max(x, zero)) >> shift, (intN)(view->cells.x - 1));
  const intN cy = min(TO_INT(lane_max(y, zero)) >> shift, (intN)(view->cells.y - 1));
  const intN cz = min(TO_INT(lane_max(z, zero)) >> shift, (intN)(view->cells.z - 1));
  const intN at = (cz * view->cells.y + cy) * view->cells.x + cx;
  return MASK((gather1(scene->constant_distances, at) & 255u) != 0u);
}
#endif

/* Composites the opacity of a segment whose middle is on slice `middle`, and queues its colours, of a packet of the
 * tile's. `acc` has colours beside those that are queued. */
INLINE void queue_lit(const Source *in, SegmentColor s, const PixelPacket *p, floatN middle, Gathered *acc, intN active,
                      Tally *counted)
{
  const floatN part = select((floatN)0.0f, 1.0f - acc->a, active);
  intN shows = active & MASK(s.a > 0.0f);
  if (!any_lane(shows)) return;
  acc->a += part * select((floatN)0.0f, s.a, active);
#if CONSTANT_CELLS
  const intN plain = shows & is_constant(in->scene, p, middle);
  const floatN plain_part = select((floatN)0.0f, part, plain);
  acc->r += plain_part * s.r, acc->g += plain_part * s.g, acc->b += plain_part * s.b;
  shows &= ~plain;
  if (!any_lane(shows)) return;
#endif
  LightQueue *queue = (LightQueue *)in->queue;
  PixelPacket *packets = (PixelPacket *)in->packets;
  if (queue->count > MOST_QUEUED - LANES) light_queue(in->scene, queue, packets, counted);
#if LIGHTING
  count_lanes(&counted[COUNT_GRADIENTS], shows);
#endif
  queue_segment(in->scene, in->pyramid, queue, s, p, (int)(p - packets), middle, part, shows);
}

#else

/* Lights a segment whose middle is on slice `middle`; `left`: what arrives from there. Returns its optical depth. */
RARE floatN light_segment(const Scene *scene, __constant const Pyramid *pyramid, SegmentColor *s, const PixelPacket *p,
                          floatN middle, floatN left, intN active, Tally *counted)
{
  const Rays ray = rays_of_packet(scene->view, p);
  const Vectors forward = packet_forward(scene, &ray);
  const floatN t = middle - LOAD_LANES(p->enter);
  const Vectors place = {ray.x0 + t * ray.dx, ray.y0 + t * ray.dy, ray.z0 + t * ray.dz};
  intN shows = active & MASK(s->a > 0.0f);
  floatN depth = s->depth;
#if GRADIENT
  const Vectors gradient = scene_gradient(scene, place.x, place.y, place.z);
  count_lanes(&counted[COUNT_GRADIENTS], shows);
#endif
#if OPACITY_FACTORS
  const floatN whole = lane_min(depth, (floatN)OPAQUE_DEPTH), before = select((floatN)1.0f, s->a, shows);
  Emission e = {s->r / before, s->g / before, s->b / before, whole};
  weigh_by_gradient(scene, &e, gradient, forward);
  depth = e.d, s->a = opacity_of_depth(depth);
  s->r *= s->a / before, s->g *= s->a / before, s->b *= s->a / before;
  shows &= MASK(s->a > 0.0f);
#endif
  Vectors color = {s->r, s->g, s->b};
#if LIGHTING
  const Vectors normal = shown_normal(scene, gradient, packet_cut_normal(scene, pyramid, p), t * scene->view->step);
  const intN lit = shows & MASK(dot3(normal, normal) > 0.5f);
  color = shaded_color(scene, color, s->a, place, normal, gradient, scaled3(forward, -1.0f), left * s->a, 0, lit,
                       counted);
#endif
#if DEPTH_CUE
  color = cued_color(scene, color, s->a, ray.entry_depth + t * scene->view->step);
#endif
  s->r = color.x, s->g = color.y, s->b = color.z;
  return depth;
}

#endif

#if ENVIRONMENT_VISIBLE
/* What is left of the rays of the packet at (column, row) of the picture sees the environment. */
INLINE void show_behind(const Source *in, PixelPacket *p, int column, int row)
{
  __constant const View *view = in->view;
  const intN px = column + (LANE_INDEX & (PACKET_W - 1)), py = row + LANE_INDEX / PACKET_W;
  const Rays ray = rays_of_packet(view, p);
  Gathered acc;
  gathered_load(&acc, p->rgba);
  show_environment(in->scene, packet_forward(in->scene, &ray), MASK(px < view->image.x) & MASK(py < view->image.y),
                   &acc);
  gathered_store(&acc, p->rgba);
}
#endif

#endif
