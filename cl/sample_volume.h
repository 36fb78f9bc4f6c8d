/* The reconstruction filters. Each takes lattice coordinates, one point a lane, and clamps them to the domain.
 *
 * To add a filter: a function with this signature, a value of FILTER in features.h, and a line in the selector below.
 */
#ifndef SAMPLE_VOLUME_H
#define SAMPLE_VOLUME_H

#include "features.h"
#include "fetch_voxel.h"

/* The lower corner of the lattice cell that holds a coordinate: 0 .. size - 2, also at the upper face. */
inline intN cell_index(floatN x, int size) { return min(TO_INT(x), (intN)(size - 2)); }

/* Trilinear: lerps as a + f (b - a), so that a constant cell gives exactly its constant. */
inline floatN sample_linear(__global const uchar *volume, __constant const View *view, floatN x, floatN y, floatN z)
{
  x = clamp(x, (floatN)0.0f, (floatN)view->upper.x);
  y = clamp(y, (floatN)0.0f, (floatN)view->upper.y);
  z = clamp(z, (floatN)0.0f, (floatN)view->upper.z);
  const intN ix = cell_index(x, view->size.x), iy = cell_index(y, view->size.y), iz = cell_index(z, view->size.z);
  const floatN fx = x - TO_FLOAT(ix), fy = y - TO_FLOAT(iy), fz = z - TO_FLOAT(iz);
  const Corners c = fetch_corners(volume, view, ix, iy, iz);
  const floatN v00 = c.v000 + fx * (c.v100 - c.v000), v10 = c.v010 + fx * (c.v110 - c.v010);
  const floatN v01 = c.v001 + fx * (c.v101 - c.v001), v11 = c.v011 + fx * (c.v111 - c.v011);
  const floatN v0 = v00 + fy * (v10 - v00), v1 = v01 + fy * (v11 - v01);
  return v0 + fz * (v1 - v0);
}

/* Nearest voxel centre; halves round up. */
inline floatN sample_nearest(__global const uchar *volume, __constant const View *view, floatN x, floatN y, floatN z)
{
  const intN nx = TO_INT(clamp(x + 0.5f, (floatN)0.0f, (floatN)view->upper.x));
  const intN ny = TO_INT(clamp(y + 0.5f, (floatN)0.0f, (floatN)view->upper.y));
  const intN nz = TO_INT(clamp(z + 0.5f, (floatN)0.0f, (floatN)view->upper.z));
  const intN ix = min(nx, (intN)(view->size.x - 2)), iy = min(ny, (intN)(view->size.y - 2));
  const intN iz = min(nz, (intN)(view->size.z - 2));
  const intN fx = MASK(nx > ix), fy = MASK(ny > iy), fz = MASK(nz > iz);
  const Corners c = fetch_corners(volume, view, ix, iy, iz);
  const floatN v00 = select(c.v000, c.v100, fx), v10 = select(c.v010, c.v110, fx);
  const floatN v01 = select(c.v001, c.v101, fx), v11 = select(c.v011, c.v111, fx);
  return select(select(v00, v10, fy), select(v01, v11, fy), fz);
}

#if FILTER == FILTER_LINEAR
#define sample_volume sample_linear
#elif FILTER == FILTER_NEAREST
#define sample_volume sample_nearest
#else
#error "FILTER is unknown"
#endif

#endif
