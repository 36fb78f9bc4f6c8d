/* Less than a block of 2^3 voxels: an edge of two along x, or a face of four in a slice, in as few gathers as the
 * voxel type allows (fetch_voxel.h has the layouts). Unlike a block's an edge's row may be the last one, and so may a
 * face's slice.
 */
#ifndef FETCH_EDGE_H
#define FETCH_EDGE_H

#include "fetch_voxel.h"
#include "lanes.h"
#include "view.h"

typedef struct {
  floatN v0, v1; /* x, x + 1 */
} Edge;

typedef struct {
  Edge low, high; /* y, y + 1 */
} Face;

/* As corner_offset(), in a row that may be the last one of what is stored, or in the last slice. */
#if OWNED_BOX
INLINE intN edge_offset(__global const uchar *volume, __constant const View *view, intN ix, intN iy, intN iz)
{
  const int4 to = view->stored_to + (int4)(0, VOXEL_PAIRS ? 0 : 1, 1, 0);
  const intN x = min(max(ix, (intN)view->stored_from.x), (intN)to.x) - view->stored_from.x;
  const intN y = min(max(iy, (intN)view->stored_from.y), (intN)to.y) - view->stored_from.y;
  const intN z = min(max(iz, (intN)view->stored_from.z), (intN)to.z) - view->stored_from.z;
  return z * view->slice_stride + y * view->row_stride + x;
}
#else
#define edge_offset corner_offset
#endif

#if VOXEL_BITS == 8 && VOXEL_PAIRS

INLINE Edge fetch_edge(__global const uchar *volume, __constant const View *view, intN ix, intN iy, intN iz)
{
  const intN pair = min(iy, (intN)(view->size.y - 2));
  const uintN w = gather2(volume, edge_offset(volume, view, ix, pair, iz)) >> (AS_UINT(iy - pair) << 3u);
  const Edge e = {BYTE(w, 0u), BYTE(w, 2u)};
  return e;
}

INLINE Face fetch_face(__global const uchar *volume, __constant const View *view, intN ix, intN iy, intN iz)
{
  const uintN w = gather2(volume, edge_offset(volume, view, ix, iy, iz));
  const Face f = {{BYTE(w, 0u), BYTE(w, 2u)}, {BYTE(w, 1u), BYTE(w, 3u)}};
  return f;
}

#else

INLINE Edge fetch_edge(__global const uchar *volume, __constant const View *view, intN ix, intN iy, intN iz)
{
  const intN at = edge_offset(volume, view, ix, iy, iz);
  Edge e;
#if VOXEL_BITS == 8
  const uintN w = gather1(volume, at);
  e.v0 = BYTE(w, 0u), e.v1 = BYTE(w, 1u);
#elif VOXEL_BITS == 16
  const uintN w = gather2(volume, at);
  e.v0 = LOW_HALF(w), e.v1 = HIGH_HALF(w);
#elif VOXEL_BITS == 32
  e.v0 = AS_FLOAT(gather4(volume, at)), e.v1 = AS_FLOAT(gather4(volume + 4, at));
#if VOXEL_SCALED
  e.v0 *= view->voxel_gain, e.v1 *= view->voxel_gain;
#endif
#else
  __global const double *voxels = (__global const double *)volume;
  const double bias = view->voxel_bias_double, gain = view->voxel_gain_double;
  int each[LANES];
  STORE_LANES(at, each);
  e.v0 = fetch_double(voxels, each, bias, gain), e.v1 = fetch_double(voxels + 1, each, bias, gain);
#endif
  return e;
}

INLINE Face fetch_face(__global const uchar *volume, __constant const View *view, intN ix, intN iy, intN iz)
{
  const Face f = {fetch_edge(volume, view, ix, iy, iz), fetch_edge(volume, view, ix, iy + 1, iz)};
  return f;
}

#endif

#endif
