/* Segments of a few steps of a packet's rays, classified at once: those of rays that show something, one after the
 * other in a vector, so that no lane is spent on what is transparent.
 *
 * In most packets a few rays cross something while the others are in front of it, behind it or between two peaks of
 * the transfer function. Classifying a segment by its pieces costs several times what sampling it does, however many
 * lanes it is for. Steps are queued for as long as their segments fit in one vector; each lane's colour is that which
 * it would have in its own place, bit for bit.
 */
#ifndef SEGMENT_QUEUE_H
#define SEGMENT_QUEUE_H

#include "classify.h"
#include "lanes.h"
#include "transfer_pieces.h"
#include "view.h"

#ifndef QUEUED_SEGMENTS
#if defined(NATIVE_LANES) && CLASSIFICATION == CLASSIFICATION_PREINTEGRATED
#define QUEUED_SEGMENTS 1
#else
#define QUEUED_SEGMENTS 0 /* lanes would be moved one by one */
#endif
#endif

/* The lanes whose segments between these values can be visible. */
INLINE intN lanes_that_show(floatN low, floatN high, __constant const View *view)
{
  const float4 above = view->shows_above, below = view->shows_below;
  intN shows = MASK(high > above.x) & MASK(low < below.x);
  if (below.y > above.y) { /* empty spans are the last ones */
    shows |= MASK(high > above.y) & MASK(low < below.y);
    shows |= MASK(high > above.z) & MASK(low < below.z);
    shows |= MASK(high > above.w) & MASK(low < below.w);
  }
  return shows;
}

#if QUEUED_SEGMENTS
#ifdef LANES_IN_AVX512

typedef struct {
  floatN front, back; /* values at their ends, in the first `count` lanes */
  int count;
} SegmentQueue;
typedef SegmentColor QueuedColors;

INLINE void empty_queue(SegmentQueue *queue) { queue->front = queue->back = 0.0f, queue->count = 0; }

/* The lanes in `bits` of v, from lane `to` on in place of those of `queued`. */
INLINE floatN queued_lanes(floatN queued, floatN v, uint bits, int to)
{
  const gather_float16 packed = __builtin_ia32_compresssf512_mask(
    __builtin_astype(v, gather_float16), __builtin_astype((float16)0.0f, gather_float16), (ushort)bits);
  const uint places = ((1u << popcount(bits)) - 1u) << to;
  return __builtin_astype(
    __builtin_ia32_expandsf512_mask(packed, __builtin_astype(queued, gather_float16), (ushort)places), float16);
}

/* Where in the queue the lanes in `bits` are, of which the first is at `from`. */
INLINE intN places_in_queue(uint bits, int from)
{
  return as_int16(__builtin_astype(
    __builtin_ia32_expandsf512_mask(__builtin_astype(LANE_INDEX + from, gather_float16),
                                    __builtin_astype((float16)0.0f, gather_float16), (ushort)bits), float16));
}

/* Appends the segments of the lanes in `bits`, which have room. */
INLINE void append_segments(SegmentQueue *queue, floatN front, floatN back, uint bits)
{
  queue->front = queued_lanes(queue->front, front, bits, queue->count);
  queue->back = queued_lanes(queue->back, back, bits, queue->count);
  queue->count += popcount(bits);
}

#define QUEUED(values) (values)
#define KEEP_COLOR(colors, s) (*(colors) = (s))

/* The colours of the lanes in `bits`; others' are undefined. */
INLINE SegmentColor queued_color(const QueuedColors *colors, uint bits, int from)
{
  const intN at = places_in_queue(bits, from);
  const SegmentColor s = {permuted_lanes(colors->r, at), permuted_lanes(colors->g, at), permuted_lanes(colors->b, at),
                          permuted_lanes(colors->a, at), colors->depth};
  return s;
}

#else

/* In memory, with room for what packing leaves behind the last lane. */
typedef struct {
  float front[2 * LANES], back[2 * LANES];
  int count;
} SegmentQueue;
typedef struct {
  float r[2 * LANES], g[2 * LANES], b[2 * LANES], a[2 * LANES];
} QueuedColors;

INLINE void empty_queue(SegmentQueue *queue)
{
  STORE_LANES((floatN)0.0f, queue->front), STORE_LANES((floatN)0.0f, queue->back);
  queue->count = 0;
}

INLINE void append_segments(SegmentQueue *queue, floatN front, floatN back, uint bits)
{
  pack_lanes(front, bits, queue->front + queue->count), pack_lanes(back, bits, queue->back + queue->count);
  queue->count += popcount(bits);
}

#define QUEUED(values) LOAD_LANES(values)
INLINE void keep_color(QueuedColors *colors, SegmentColor s)
{
  STORE_LANES(s.r, colors->r), STORE_LANES(s.g, colors->g), STORE_LANES(s.b, colors->b), STORE_LANES(s.a, colors->a);
}
#define KEEP_COLOR(colors, s) keep_color(colors, s)

INLINE SegmentColor queued_color(const QueuedColors *colors, uint bits, int from)
{
  const SegmentColor s = {unpack_lanes(colors->r + from, bits), unpack_lanes(colors->g + from, bits),
                          unpack_lanes(colors->b + from, bits), unpack_lanes(colors->a + from, bits), 0.0f};
  return s;
}

#endif

/* The colours of what is queued, one step long each. */
INLINE void colors_of_queue(const SegmentQueue *queue, __global const float *table, __constant const View *view,
                            QueuedColors *colors)
{
  const Pieces f = scene_pieces(table, (intN)0, view);
  KEEP_COLOR(colors, color_of_segment(QUEUED(queue->front), QUEUED(queue->back), (floatN)view->step_units,
                                      MASK(LANE_INDEX < queue->count), f));
}

#endif

#endif
