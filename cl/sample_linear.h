/* Trilinear samples: the lattice cell of a place (clamped to the domain), its corners, and the value between them. */
#ifndef SAMPLE_LINEAR_H
#define SAMPLE_LINEAR_H

#include "fetch_voxel.h"
#include "lanes.h"
#include "view.h"

/* The lower corner of the lattice cell that holds a coordinate: 0 .. size - 2, also at the upper face. */
INLINE intN cell_index(floatN x, int size) { return min(TO_INT(x), (intN)(size - 2)); }

/* a + f (b - a), so that a constant cell gives exactly its constant. VOXEL_HOLES: some voxel is not finite, and what
 * has weight 0 must not count, since 0 times it is not 0. */
INLINE floatN mix_corners(floatN a, floatN b, floatN f)
{
  const floatN mixed = a + f * (b - a);
#if VOXEL_HOLES
  return select(select(mixed, a, MASK(f == 0.0f)), b, MASK(f == 1.0f));
#else
  return mixed;
#endif
}

typedef struct {
  FetchedCorners corners;
  floatN fx, fy, fz; /* place inside the lattice cell, 0 .. 1 */
} CellSample;

/* A sample's cell, and the place in it. */
typedef struct {
  intN corner; /* corner_offset() */
  floatN fx, fy, fz;
} SamplePlace;

INLINE SamplePlace linear_place(__global const uchar *volume, __constant const View *view, floatN x, floatN y, floatN z)
{
  SamplePlace p;
  x = lane_clamp(x, (floatN)0.0f, (floatN)view->upper.x);
  y = lane_clamp(y, (floatN)0.0f, (floatN)view->upper.y);
  z = lane_clamp(z, (floatN)0.0f, (floatN)view->upper.z);
  const intN ix = cell_index(x, view->size.x), iy = cell_index(y, view->size.y), iz = cell_index(z, view->size.z);
  p.fx = x - TO_FLOAT(ix), p.fy = y - TO_FLOAT(iy), p.fz = z - TO_FLOAT(iz);
  p.corner = corner_offset(volume, view, ix, iy, iz);
  return p;
}

INLINE CellSample fetched_at(SamplePlace p, FetchedCorners corners)
{
  const CellSample s = {corners, p.fx, p.fy, p.fz};
  return s;
}

INLINE CellSample fetch_linear(__global const uchar *volume, __constant const View *view, floatN x, floatN y,
                               floatN z)
{
  const SamplePlace p = linear_place(volume, view, x, y, z);
  return fetched_at(p, fetch_corners_at(volume, view, p.corner));
}

INLINE floatN linear_value(CellSample s, __constant const View *view)
{
  const Corners c = decode_corners(s.corners, view);
  const floatN v00 = mix_corners(c.v000, c.v100, s.fx), v10 = mix_corners(c.v010, c.v110, s.fx);
  const floatN v01 = mix_corners(c.v001, c.v101, s.fx), v11 = mix_corners(c.v011, c.v111, s.fx);
  return mix_corners(mix_corners(v00, v10, s.fy), mix_corners(v01, v11, s.fy), s.fz);
}

#endif
