/* The reconstruction filters: fetch_sample() for lattice points (clamped to the domain), then its value.
 *
 * To add a filter: its two functions, a value of FILTER in features.h, and a line in the selector below.
 */
#ifndef SAMPLE_VOLUME_H
#define SAMPLE_VOLUME_H

#include "features.h"
#include "fetch_voxel.h"

/* The lower corner of the lattice cell that holds a coordinate: 0 .. size - 2, also at the upper face. */
INLINE intN cell_index(floatN x, int size) { return min(TO_INT(x), (intN)(size - 2)); }

typedef struct {
  FetchedCorners corners;
  floatN fx, fy, fz; /* place inside the lattice cell, 0 .. 1 */
} FetchedSample;

INLINE FetchedSample fetch_linear(__global const uchar *volume, __constant const View *view, floatN x, floatN y, floatN z)
{
  FetchedSample s;
  x = lane_clamp(x, (floatN)0.0f, (floatN)view->upper.x);
  y = lane_clamp(y, (floatN)0.0f, (floatN)view->upper.y);
  z = lane_clamp(z, (floatN)0.0f, (floatN)view->upper.z);
  const intN ix = cell_index(x, view->size.x), iy = cell_index(y, view->size.y), iz = cell_index(z, view->size.z);
  s.fx = x - TO_FLOAT(ix), s.fy = y - TO_FLOAT(iy), s.fz = z - TO_FLOAT(iz);
  s.corners = fetch_corners(volume, view, ix, iy, iz);
  return s;
}

/* a + f (b - a), so that a constant cell gives exactly its constant. VOXEL_HOLES: some voxel is not finite, and what has
 * weight 0 must not count, since 0 times it is not 0. */
INLINE floatN mix_corners(floatN a, floatN b, floatN f)
{
  const floatN mixed = a + f * (b - a);
#if VOXEL_HOLES
  return select(select(mixed, a, MASK(f == 0.0f)), b, MASK(f == 1.0f));
#else
  return mixed;
#endif
}

INLINE floatN linear_value(FetchedSample s, __constant const View *view)
{
  const Corners c = decode_corners(s.corners, view);
  const floatN v00 = mix_corners(c.v000, c.v100, s.fx), v10 = mix_corners(c.v010, c.v110, s.fx);
  const floatN v01 = mix_corners(c.v001, c.v101, s.fx), v11 = mix_corners(c.v011, c.v111, s.fx);
  return mix_corners(mix_corners(v00, v10, s.fy), mix_corners(v01, v11, s.fy), s.fz);
}

/* Nearest voxel centre; halves round up. The fetched cell is the one that has it as a corner. */
INLINE FetchedSample fetch_nearest(__global const uchar *volume, __constant const View *view, floatN x, floatN y, floatN z)
{
  FetchedSample s;
  const intN nx = TO_INT(lane_clamp(x + 0.5f, (floatN)0.0f, (floatN)view->upper.x));
  const intN ny = TO_INT(lane_clamp(y + 0.5f, (floatN)0.0f, (floatN)view->upper.y));
  const intN nz = TO_INT(lane_clamp(z + 0.5f, (floatN)0.0f, (floatN)view->upper.z));
  const intN ix = min(nx, (intN)(view->size.x - 2)), iy = min(ny, (intN)(view->size.y - 2));
  const intN iz = min(nz, (intN)(view->size.z - 2));
  s.fx = TO_FLOAT(nx - ix), s.fy = TO_FLOAT(ny - iy), s.fz = TO_FLOAT(nz - iz);
  s.corners = fetch_corners(volume, view, ix, iy, iz);
  return s;
}

INLINE floatN nearest_value(FetchedSample s, __constant const View *view)
{
  const Corners c = decode_corners(s.corners, view);
  const intN fx = MASK(s.fx > 0.5f), fy = MASK(s.fy > 0.5f), fz = MASK(s.fz > 0.5f);
  const floatN v00 = select(c.v000, c.v100, fx), v10 = select(c.v010, c.v110, fx);
  const floatN v01 = select(c.v001, c.v101, fx), v11 = select(c.v011, c.v111, fx);
  return select(select(v00, v10, fy), select(v01, v11, fy), fz);
}

#if FILTER == FILTER_LINEAR
#define fetch_sample fetch_linear
#define sample_value linear_value
#elif FILTER == FILTER_NEAREST
#define fetch_sample fetch_nearest
#define sample_value nearest_value
#else
#error "FILTER is unknown"
#endif

#endif
