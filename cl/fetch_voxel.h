/* Corners of lattice cells, fetched for a packet of rays in as few gathers as the voxel type allows.
 *
 * 8 bit: the device holds pairs (v[y], v[y + 1]) for every x (twice the memory): one 32-bit word at (x, y) then has
 * the four corners x, x + 1 by y, y + 1, so a trilinear sample is two gathers. Where that would be too much memory
 * (VOXEL_PAIRS 0) four. (Pairs in bricks of one cache line each were tried: the arithmetic cost more than the cache
 * gave.) 16 bit: a word has x and x + 1, four gathers. 32 bit: eight gathers. 64 bit: eight loads a lane, brought into
 * float range as (v - bias) * gain in double. Indices are those of the lower corner and at most size - 2, so no fetch
 * leaves the buffer.
 *
 * Finding a cell, fetching and decoding are functions of their own, so that a march can fetch ahead: a fetch waits for
 * the cache much longer than all arithmetic takes. fetch_corners_at() takes what corner_offset() gives.
 */
#ifndef FETCH_VOXEL_H
#define FETCH_VOXEL_H

#include "lanes.h"
#include "view.h"

typedef struct {
  floatN v000, v100, v010, v110, v001, v101, v011, v111; /* vXYZ */
} Corners;

/* Elements from the first voxel (or pair) to the lower corner: below 2^31, as the host makes sure. Bytes from there to
 * the next row and slice may be more.
 *
 * BRICKS, where it is not 0, is the logarithm of a brick's edge: the volume is then bricks of 2^BRICKS voxels an axis,
 * with a further one along each axis (fill_bricks.cl), in any order behind a table of them. A brick's entry is where
 * its first voxel is, less what the lattice point there adds here: so one look-up is all that a cell in a brick needs,
 * and its corners are in the one brick.
 */
#if BRICKS
INLINE intN corner_offset(__global const uchar *volume, __constant const View *view, intN ix, intN iy, intN iz)
{
  const int nx = ((view->size.x - 1) >> BRICKS) + 1, ny = ((view->size.y - 1) >> BRICKS) + 1;
  const intN brick = ((iz >> BRICKS) * ny + (iy >> BRICKS)) * nx + (ix >> BRICKS);
  return AS_INT(gather4(volume, brick)) + iz * view->slice_stride + iy * view->row_stride + ix;
}
#elif OWNED_BOX
/* Of voxels that are not here, others are fetched: nothing that depends on them is composited (owned_box.h). */
INLINE intN corner_offset(__global const uchar *volume, __constant const View *view, intN ix, intN iy, intN iz)
{
  const intN x = min(max(ix, (intN)view->stored_from.x), (intN)view->stored_to.x) - view->stored_from.x;
  const intN y = min(max(iy, (intN)view->stored_from.y), (intN)view->stored_to.y) - view->stored_from.y;
  const intN z = min(max(iz, (intN)view->stored_from.z), (intN)view->stored_to.z) - view->stored_from.z;
  return z * view->slice_stride + y * view->row_stride + x;
}
#else
INLINE intN corner_offset(__global const uchar *volume, __constant const View *view, intN ix, intN iy, intN iz)
{
  return iz * view->slice_stride + iy * view->row_stride + ix;
}
#endif
#define ELEMENT_BYTES (VOXEL_PAIRS ? 2 : VOXEL_BITS / 8)
INLINE size_t row_bytes(__constant const View *view) { return ELEMENT_BYTES * (size_t)view->row_stride; }
INLINE size_t slice_bytes(__constant const View *view) { return ELEMENT_BYTES * (size_t)view->slice_stride; }

/* fetch_corners_apart() takes the bytes from one row and from one slice to the next: levels have others (volume_levels.h). */

#if VOXEL_BITS == 8

#if VOXEL_SIGNED
#define BYTE(w, k) TO_FLOAT(AS_INT((w) << (24u - 8u * (k))) >> 24)
#else
#define BYTE(w, k) TO_FLOAT(AS_INT(((w) >> (8u * (k))) & 255u))
#endif

typedef struct {
  uintN low, high;
} FetchedCorners;

#if VOXEL_PAIRS

INLINE FetchedCorners fetch_corners_apart(__global const uchar *volume, __constant const View *view, intN at, size_t row,
                                          size_t slice)
{
  const FetchedCorners f = {gather2(volume, at), gather2(volume + slice, at)};
  return f;
}

INLINE Corners decode_corners(FetchedCorners f, __constant const View *view)
{
  Corners c;
  c.v000 = BYTE(f.low, 0u), c.v010 = BYTE(f.low, 1u), c.v100 = BYTE(f.low, 2u), c.v110 = BYTE(f.low, 3u);
  c.v001 = BYTE(f.high, 0u), c.v011 = BYTE(f.high, 1u), c.v101 = BYTE(f.high, 2u), c.v111 = BYTE(f.high, 3u);
  return c;
}

#else

INLINE FetchedCorners fetch_corners_apart(__global const uchar *volume, __constant const View *view, intN at, size_t row,
                                          size_t slice)
{
  const FetchedCorners f = {(gather1(volume, at) & 0xffffu) | (gather1(volume + row, at) << 16u),
                            (gather1(volume + slice, at) & 0xffffu) | (gather1(volume + slice + row, at) << 16u)};
  return f;
}

INLINE Corners decode_corners(FetchedCorners f, __constant const View *view)
{
  Corners c;
  c.v000 = BYTE(f.low, 0u), c.v100 = BYTE(f.low, 1u), c.v010 = BYTE(f.low, 2u), c.v110 = BYTE(f.low, 3u);
  c.v001 = BYTE(f.high, 0u), c.v101 = BYTE(f.high, 1u), c.v011 = BYTE(f.high, 2u), c.v111 = BYTE(f.high, 3u);
  return c;
}

#endif

#elif VOXEL_BITS == 16

#if VOXEL_SIGNED
#define LOW_HALF(w) TO_FLOAT(AS_INT((w) << 16u) >> 16)
#define HIGH_HALF(w) TO_FLOAT(AS_INT(w) >> 16)
#else
#define LOW_HALF(w) TO_FLOAT(AS_INT((w) & 65535u))
#define HIGH_HALF(w) TO_FLOAT(AS_INT((w) >> 16u))
#endif

typedef struct {
  uintN w00, w10, w01, w11; /* wYZ */
} FetchedCorners;

INLINE FetchedCorners fetch_corners_apart(__global const uchar *volume, __constant const View *view, intN at, size_t row,
                                          size_t slice)
{
  const FetchedCorners f = {gather2(volume, at), gather2(volume + row, at), gather2(volume + slice, at),
                            gather2(volume + slice + row, at)};
  return f;
}

INLINE Corners decode_corners(FetchedCorners f, __constant const View *view)
{
  Corners c;
  c.v000 = LOW_HALF(f.w00), c.v100 = HIGH_HALF(f.w00), c.v010 = LOW_HALF(f.w10), c.v110 = HIGH_HALF(f.w10);
  c.v001 = LOW_HALF(f.w01), c.v101 = HIGH_HALF(f.w01), c.v011 = LOW_HALF(f.w11), c.v111 = HIGH_HALF(f.w11);
  return c;
}

#else

typedef Corners FetchedCorners;

#if VOXEL_BITS == 32

INLINE FetchedCorners fetch_corners_apart(__global const uchar *volume, __constant const View *view, intN at, size_t row,
                                          size_t slice)
{
  Corners c;
  c.v000 = AS_FLOAT(gather4(volume, at)), c.v100 = AS_FLOAT(gather4(volume + 4, at));
  c.v010 = AS_FLOAT(gather4(volume + row, at)), c.v110 = AS_FLOAT(gather4(volume + row + 4, at));
  c.v001 = AS_FLOAT(gather4(volume + slice, at)), c.v101 = AS_FLOAT(gather4(volume + slice + 4, at));
  c.v011 = AS_FLOAT(gather4(volume + slice + row, at)), c.v111 = AS_FLOAT(gather4(volume + slice + row + 4, at));
  return c;
}

#elif VOXEL_BITS == 64

INLINE floatN fetch_double(__global const double *volume, const int *at, double bias, double gain)
{
  float v[LANES];
  EACH_LANE(k) v[k] = (float)((volume[at[k]] - bias) * gain);
  return LOAD_LANES(v);
}

INLINE FetchedCorners fetch_corners_apart(__global const uchar *bytes, __constant const View *view, intN corner,
                                          size_t to_row, size_t to_slice)
{
  Corners c;
  __global const double *volume = (__global const double *)bytes;
  int at[LANES];
  STORE_LANES(corner, at);
  const size_t row = to_row / sizeof(double), slice = to_slice / sizeof(double);
  const double bias = view->voxel_bias_double, gain = view->voxel_gain_double;
  c.v000 = fetch_double(volume, at, bias, gain), c.v100 = fetch_double(volume + 1, at, bias, gain);
  c.v010 = fetch_double(volume + row, at, bias, gain), c.v110 = fetch_double(volume + row + 1, at, bias, gain);
  c.v001 = fetch_double(volume + slice, at, bias, gain), c.v101 = fetch_double(volume + slice + 1, at, bias, gain);
  c.v011 = fetch_double(volume + slice + row, at, bias, gain);
  c.v111 = fetch_double(volume + slice + row + 1, at, bias, gain);
  return c;
}

#else
#error "VOXEL_BITS must be 8, 16, 32 or 64"
#endif

/* VOXEL_SCALED: a gain, a power of two, brings extreme float32 ranges to where differences neither overflow nor
 * vanish. */
INLINE Corners decode_corners(FetchedCorners f, __constant const View *view)
{
#if VOXEL_SCALED
  const float gain = view->voxel_gain;
  f.v000 *= gain, f.v100 *= gain, f.v010 *= gain, f.v110 *= gain;
  f.v001 *= gain, f.v101 *= gain, f.v011 *= gain, f.v111 *= gain;
#endif
  return f;
}

#endif

INLINE FetchedCorners fetch_corners_at(__global const uchar *volume, __constant const View *view, intN at)
{
  return fetch_corners_apart(volume, view, at, row_bytes(view), slice_bytes(view));
}

/* Those of a cell whose lower corner is there. */
INLINE FetchedCorners fetch_corners(__global const uchar *volume, __constant const View *view, intN ix, intN iy,
                                    intN iz)
{
  return fetch_corners_at(volume, view, corner_offset(volume, view, ix, iy, iz));
}

#endif
