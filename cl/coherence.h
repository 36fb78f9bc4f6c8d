/* From frame to frame (Klein et al. 2005): where each ray may start, and where it first contributed.
 *
 * starts  float [height, width]: depth in edges behind the reference plane before which the pixel's ray contributes
 *         nothing, as the frame before suggests (reproject.cl); INFINITY: nothing is known, the ray starts at the hull
 * kept    float [height, width]: of HIT pixels the depth behind the reference plane, >= 0, of the front of the first
 *         segment, or of the surface, whose opacity is not exactly 0; of EXIT pixels, which meet nothing, KEPT_EXIT of
 *         the depth at which they leave the volume; of pixels beside the volume INFINITY (NONE)
 *
 * Rays keep to the steps that they would take from the hull, and begin at least two of them before the start. So a
 * picture is bit for bit that without coherence wherever the start is not late.
 */
#ifndef COHERENCE_H
#define COHERENCE_H

#include "lanes.h"
#include "rays.h"
#include "view.h"

#if COHERENT

#define COHERENT_PARAMETERS , __global const float *restrict starts, __global float *restrict kept
/* The last parameter of render_packet(): floatN, the distance in edges from the eye to where a ray first contributes;
 * INFINITY where it never does. */
#define FIRST_PARAMETER , floatN *first
#define FIRST_ARGUMENT , &first

#define KEPT_EXIT(depth) (-1.0f - (depth))

/* The lanes whose opacity is no longer exactly 0: they first contribute at `at`. */
#define NOTE_FIRST(before, after, at) \
  *first = select(*first, lane_min(at, *first), MASK((before) <= 0.0f) & MASK((after) > 0.0f))

INLINE floatN start_of_lanes(__global const float *starts, __constant const View *view, intN px, intN py)
{
  int column[LANES], row[LANES];
  float at[LANES];
  STORE_LANES(px, column), STORE_LANES(py, row);
  EACH_LANE(k)
  {
    const int inside = column[k] < view->image.x && row[k] < view->image.y;
    at[k] = inside ? starts[(size_t)row[k] * view->image.x + column[k]] : INFINITY;
  }
  const floatN start = LOAD_LANES(at);
  return select(start, -(floatN)INFINITY, MASK(start == INFINITY));
}

/* What is kept of rays that first contribute at `first`. */
INLINE floatN depth_to_keep(__constant const View *view, intN px, intN py, floatN first)
{
  const floatN column = TO_FLOAT(px), row = TO_FLOAT(py);
  const Rays ray = make_rays_of_step(view, column, row, 1.0f);
  const floatN a = (column - view->centre.x) * view->tangent.x, b = (row - view->centre.y) * view->tangent.y;
  const floatN per_slant = 1.0f / sqrt(1.0f + a * a + b * b);
  const intN hits = MASK(first < INFINITY), inside = MASK(ray.length >= 0.0f);
  const floatN at = select(ray.entry_depth + ray.length, first, hits);
  const floatN depth = lane_max(at * per_slant - view->plane_distance, (floatN)0.0f);
  return select((floatN)INFINITY, select(KEPT_EXIT(depth), depth, hits), inside);
}

#else

#define COHERENT_PARAMETERS
#define FIRST_PARAMETER
#define FIRST_ARGUMENT
#define NOTE_FIRST(before, after, at)

#endif

#endif
