/* From frame to frame (Klein et al. 2005): where each ray may start, and where it first contributed.
 *
 * starts  float [height, width]: depth in edges behind the reference plane before which the pixel's ray contributes
 *         nothing, as the frame before suggests (reproject.cl); INFINITY: nothing is known, the ray starts at the hull
 * kept    float [height, width]: of HIT pixels the depth behind the reference plane, >= 0, of the front of the first
 *         segment, or of the surface, whose opacity is not exactly 0; of EXIT pixels, which meet nothing, KEPT_EXIT of
 *         a depth behind the volume; of pixels beside the volume, or whose packet's span is empty, INFINITY (NONE)
 *
 * tallies uint [tiles, 4]: rays that started where the frame before suggests; those that contribute, and of which
 *         nothing was known; audited rays that contributed before their start; samples of audited rays
 *
 * Some packets are audited: they start at the hull, and it is seen whether their starts would have been late. Their
 * starts are marked by the lowest bit of the float.
 *
 * Rays keep to the steps that they would take from the hull, and begin at least two of them before the start. Of the
 * first segment that they pass then, the sample before it is not known, by which its ends would be corrected: it is
 * known to show nothing, and left out (blind_segments). So a picture is bit for bit that without coherence wherever the
 * start is not late.
 */
#ifndef COHERENCE_H
#define COHERENCE_H

#include "lanes.h"
#include "rays.h"
#include "tally.h"
#include "view.h"

#if COHERENT

#define COHERENT_PARAMETERS \
  , __global const float *restrict starts, __global float *restrict kept, __global uint *restrict tallies
#define KEPT_PARAMETER , __global float *restrict kept
#define KEPT_ARGUMENT , kept
#define STORE_KEPT(depth, pixel) kept[pixel] = (depth);
#define STORE_KEPT4(depth, pixel) vstore4((float4)(depth), 0, kept + (pixel));
#define TALLY_REUSED 0
#define TALLY_HOLES 1
#define TALLY_LATE 2
#define TALLY_AUDITED 3
/* Edges that a start may seem late by rounding. */
#define NOT_LATE 1e-3f
/* The last parameter of render_packet(): floatN, the distance in edges from the eye to where a ray first contributes;
 * INFINITY where it never does, -INFINITY of rays beside the volume. */
#define FIRST_PARAMETER , floatN *first
#define FIRST_ARGUMENT , &first

/* 1 where samples begin within the ray, at step `start`: after a leap the first segment is in empty space. */
INLINE intN blind_segments(intN start) { return MASK(start > 0) & 1; }

#define KEPT_EXIT(depth) (-1.0f - (depth))

#define BEGIN_FIRST(hits) *first = select(-(floatN)INFINITY, (floatN)INFINITY, hits)
/* The lanes whose opacity is no longer exactly 0: they first contribute at `at`. */
#define NOTE_FIRST(before, after, at) \
  *first = select(*first, lane_min(at, *first), MASK((before) <= 0.0f) & MASK((after) > 0.0f))

/* Starts as they are in the array: -INFINITY where nothing is known, or beside the picture. (column, row): the packet's
 * first pixel. */
INLINE floatN start_of_lanes(__global const float *starts, __constant const View *view, int column, int row)
{
  const int width = view->image.x, height = view->image.y;
  float at[LANES];
#if LANES == 16
  if (column + PACKET_W <= width && row + PACKET_H <= height) {
    for (int y = 0; y < PACKET_H; ++y) vstore4(vload4(0, starts + (size_t)(row + y) * width + column), y, at);
  } else
#endif
    EACH_LANE_ROLLED(k)
    {
      const int x = column + k % PACKET_W, y = row + k / PACKET_W;
      at[k] = x < width && y < height ? starts[(size_t)y * width + x] : INFINITY;
    }
  const floatN start = LOAD_LANES(at);
  return select(start, -(floatN)INFINITY, MASK(start == INFINITY));
}

INLINE intN audited_lanes(floatN start) { return MASK((AS_INT(start) & 1) != 0) & MASK(start > -(floatN)INFINITY); }

/* What is kept of rays that first contribute at `first`. */
INLINE floatN depth_to_keep(__constant const View *view, intN px, intN py, floatN first)
{
  const floatN a = (TO_FLOAT(px) - view->centre.x) * view->tangent.x;
  const floatN b = (TO_FLOAT(py) - view->centre.y) * view->tangent.y;
  const floatN depth = lane_max(first * lane_rsqrt(1.0f + a * a + b * b) - view->plane_distance, (floatN)0.0f);
  const floatN met = select(depth, (floatN)KEPT_EXIT(view->deepest), MASK(first == INFINITY));
  return select(met, (floatN)INFINITY, MASK(first == -(floatN)INFINITY));
}

#else

#define COHERENT_PARAMETERS
#define KEPT_PARAMETER
#define KEPT_ARGUMENT
#define STORE_KEPT(depth, pixel)
#define STORE_KEPT4(depth, pixel)
#define FIRST_PARAMETER
#define FIRST_ARGUMENT
#define BEGIN_FIRST(hits)
INLINE intN blind_segments(intN start) { return (intN)0; }
#define NOTE_FIRST(before, after, at)

#endif

#endif
