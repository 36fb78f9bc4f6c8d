/* The gradient of the field at lattice points (clamped to the domain): gradient_at(), change of the value that kernels
 * compute per lattice unit, along the lattice axes. What is not finite is 0. Switch GRADIENT:
 *
 *   CENTRAL      on the fly: differences of voxels over two voxels, one-sided over one at the volume's faces,
 *                interpolated trilinearly (under the nearest filter: those of the nearest voxel)                  32
 *                voxels
 *   SOBEL        on the fly: the derivative [-1 0 1]/2 along the axis, one-sided at faces, of voxels smoothed by [1 2
 *                1]/4 along the other two, beyond faces the outermost ones; interpolated likewise
 *                64 voxels
 *   PRECOMPUTED  either of the two at the voxels, held in four bytes each (gradients.cl), interpolated likewise    8
 *                words
 *   ANALYTIC     the derivative of a filter of 64 voxels (sample_volume.h)                                        64
 *                voxels
 *
 * To add one: a function of gradient_at()'s form, and a value of GRADIENT in features.h.
 */
#ifndef GRADIENT_H
#define GRADIENT_H

#include "features.h"
#include "fetch_edge.h"
#include "lanes.h"
#include "sample_volume.h"
#include "view.h"

typedef struct {
  floatN x, y, z;
} Gradient;

/* The lattice cell that an axis' coordinate is in, and the place in it, 0 ... 1. */
typedef struct {
  intN index;
  floatN f;
} Place;

INLINE Place place_in_cell(floatN x, float upper, int size)
{
  Place p;
#if FILTER == FILTER_NEAREST /* halves round up, as in fetch_nearest() */
  const intN nearest = TO_INT(lane_clamp(x + 0.5f, (floatN)0.0f, (floatN)upper));
  p.index = min(nearest, (intN)(size - 2));
  p.f = TO_FLOAT(nearest - p.index);
#else
  x = lane_clamp(x, (floatN)0.0f, (floatN)upper);
  p.index = cell_index(x, size);
  p.f = x - TO_FLOAT(p.index);
#endif
  return p;
}

/* A gradient that is not finite in one component has no direction: none. */
INLINE Gradient finite_gradient(Gradient g)
{
#if VOXEL_HOLES
  const floatN sum = (g.x - g.x) + (g.y - g.y) + (g.z - g.z), zero = 0.0f;
  const intN bad = MASK((AS_INT(sum) & 0x7f800000) == 0x7f800000);
  g.x = select(g.x, zero, bad), g.y = select(g.y, zero, bad), g.z = select(g.z, zero, bad);
#endif
  return g;
}

#if GRADIENT == GRADIENT_CENTRAL

/* Along an axis, whose four voxels (or means across it) are a, b, c, d, those missing at a face equal to their
 * neighbours. */
INLINE floatN mixed_differences(floatN a, floatN b, floatN c, floatN d, intN first, intN last, floatN f)
{
  const floatN whole = 1.0f, part = 0.5f;
  return mix_corners((c - a) * select(part, whole, first), (d - b) * select(part, whole, last), f);
}

INLINE floatN mix_edge(Edge e, floatN f) { return mix_corners(e.v0, e.v1, f); }

INLINE floatN mix_face(Face face, floatN fx, floatN fy)
{
  return mix_corners(mix_edge(face.low, fx), mix_edge(face.high, fx), fy);
}

INLINE floatN mix_four(floatN v00, floatN v10, floatN v01, floatN v11, floatN f, floatN g)
{
  return mix_corners(mix_corners(v00, v10, f), mix_corners(v01, v11, f), g);
}

INLINE Gradient central_gradient(__global const uchar *volume, __constant const View *view, Place x, Place y, Place z)
{
  const intN first_x = MASK(x.index == 0), last_x = MASK(x.index == view->size.x - 2);
  const intN first_y = MASK(y.index == 0), last_y = MASK(y.index == view->size.y - 2);
  const intN first_z = MASK(z.index == 0), last_z = MASK(z.index == view->size.z - 2);
  const intN zero = 0, one = 1;
  const intN low_x = x.index - select(one, zero, first_x), high_x = x.index + select(one, zero, last_x);
  const intN low_y = y.index - select(one, zero, first_y), high_y = y.index + select((intN)2, one, last_y);
  const intN low_z = z.index - select(one, zero, first_z), high_z = z.index + select((intN)2, one, last_z);

  /* Two blocks side by side along x: they hold the cell itself, too. */
  const Corners a = decode_corners(fetch_corners(volume, view, low_x, y.index, z.index), view);
  const Corners d = decode_corners(fetch_corners(volume, view, high_x, y.index, z.index), view);
  const floatN b00 = select(a.v100, a.v000, first_x), b10 = select(a.v110, a.v010, first_x);
  const floatN b01 = select(a.v101, a.v001, first_x), b11 = select(a.v111, a.v011, first_x);
  const floatN c00 = select(d.v000, d.v100, last_x), c10 = select(d.v010, d.v110, last_x);
  const floatN c01 = select(d.v001, d.v101, last_x), c11 = select(d.v011, d.v111, last_x);
  Gradient g;
  g.x = mixed_differences(mix_four(a.v000, a.v010, a.v001, a.v011, y.f, z.f), mix_four(b00, b10, b01, b11, y.f, z.f),
                          mix_four(c00, c10, c01, c11, y.f, z.f), mix_four(d.v100, d.v110, d.v101, d.v111, y.f, z.f),
                              first_x,
                          last_x, x.f);

  const floatN m00 = mix_corners(b00, c00, x.f), m10 = mix_corners(b10, c10, x.f); /* mYZ */
  const floatN m01 = mix_corners(b01, c01, x.f), m11 = mix_corners(b11, c11, x.f);
  const Face above = {fetch_edge(volume, view, x.index, low_y, z.index),
                      fetch_edge(volume, view, x.index, low_y, z.index + 1)};
  const Face below = {fetch_edge(volume, view, x.index, high_y, z.index),
                      fetch_edge(volume, view, x.index, high_y, z.index + 1)};
  g.y = mixed_differences(mix_face(above, x.f, z.f), mix_corners(m00, m01, z.f), mix_corners(m10, m11, z.f),
                          mix_face(below, x.f, z.f), first_y, last_y, y.f);

  const Face before = fetch_face(volume, view, x.index, y.index, low_z);
  const Face behind = fetch_face(volume, view, x.index, y.index, high_z);
  g.z = mixed_differences(mix_face(before, x.f, y.f), mix_corners(m00, m10, y.f), mix_corners(m01, m11, y.f),
                          mix_face(behind, x.f, y.f), first_z, last_z, z.f);
  return g;
}

#if VOXEL_BITS == 8 && VOXEL_PAIRS

/* Of one slice the pairs of rows y - 1 and y + 1 on, each from x - 1 to x + 2; of all that a gradient depends on. */
typedef struct {
  uintN low0, high0, low1, high1;
} SliceWords;
typedef struct {
  SliceWords slice0, slice1; /* z, z + 1 */
  uintN before, behind;      /* the cell's corners in slices z - 1, z + 2 */
  floatN fx, fy, fz;
} GradientWords;

/* What one slice has for the differences along x and y, and its means at y and y + 1. */
typedef struct {
  floatN dx, dy; /* differences over two voxels */
  floatN m0, m1;
} SliceDifferences;

#if BRICKS
/* In four gathers, since what is needed may be in several bricks. */
INLINE SliceWords fetch_slice(__global const uchar *volume, __constant const View *view, intN ix, intN iy, intN iz)
{
  SliceWords s;
  s.low0 = gather2(volume, corner_offset(volume, view, ix - 1, iy - 1, iz));
  s.high0 = gather2(volume, corner_offset(volume, view, ix + 1, iy - 1, iz));
  s.low1 = gather2(volume, corner_offset(volume, view, ix - 1, iy + 1, iz));
  s.high1 = gather2(volume, corner_offset(volume, view, ix + 1, iy + 1, iz));
  return s;
}
#else
/* In two gathers of 64 bits, `slice` bytes behind the cell's corner. */
INLINE SliceWords fetch_slice(__global const uchar *volume, __constant const View *view, intN corner, size_t slice)
{
  SliceWords s;
  __global const uchar *above = volume + slice - row_bytes(view) - ELEMENT_BYTES;
  gather_two2(above, corner, &s.low0, &s.high0);
  gather_two2(above + 2 * row_bytes(view), corner, &s.low1, &s.high1);
  return s;
}
#endif

#if !BRICKS
/* A gradient in stages, for loops over several that need no voxel beyond the faces: fetch_gradient_words() at the cell's
 * corner_offset(), with the place in the cell beside it; gradient_of_words(). */
#define GRADIENTS_IN_STAGES 1

INLINE void fetch_gradient_words(__global const uchar *volume, __constant const View *view, intN corner,
                                 GradientWords *w)
{
  const size_t slice = slice_bytes(view);
  w->slice0 = fetch_slice(volume, view, corner, 0), w->slice1 = fetch_slice(volume, view, corner, slice);
  w->before = gather2(volume - slice, corner), w->behind = gather2(volume + 2 * slice, corner);
}
#endif

/* Away from the volume's faces: six gathers (of bricks ten). */
INLINE GradientWords fetch_gradient(__global const uchar *volume, __constant const View *view, Place x, Place y,
                                    Place z)
{
  GradientWords w;
#if BRICKS
  w.slice0 = fetch_slice(volume, view, x.index, y.index, z.index);
  w.slice1 = fetch_slice(volume, view, x.index, y.index, z.index + 1);
  w.before = gather2(volume, corner_offset(volume, view, x.index, y.index, z.index - 1));
  w.behind = gather2(volume, corner_offset(volume, view, x.index, y.index, z.index + 2));
#else
  fetch_gradient_words(volume, view, corner_offset(volume, view, x.index, y.index, z.index), &w);
#endif
  w.fx = x.f, w.fy = y.f, w.fz = z.f;
  return w;
}

INLINE SliceDifferences slice_differences(SliceWords w, floatN fx, floatN fy)
{
  SliceDifferences s;
  const floatN b1 = BYTE(w.low0, 3u), c1 = BYTE(w.high0, 1u), b2 = BYTE(w.low1, 2u), c2 = BYTE(w.high1, 0u);
  const floatN at_x0 = mix_corners(c1 - BYTE(w.low0, 1u), c2 - BYTE(w.low1, 0u), fy);
  const floatN at_x1 = mix_corners(BYTE(w.high0, 3u) - b1, BYTE(w.high1, 2u) - b2, fy);
  s.dx = mix_corners(at_x0, at_x1, fx);
  s.m0 = mix_corners(b1, c1, fx), s.m1 = mix_corners(b2, c2, fx);
  const floatN above = mix_corners(BYTE(w.low0, 2u), BYTE(w.high0, 0u), fx);
  s.dy = mix_corners(s.m1 - above, mix_corners(BYTE(w.low1, 3u), BYTE(w.high1, 1u), fx) - s.m0, fy);
  return s;
}

INLINE Gradient gradient_of_words(GradientWords w)
{
  const floatN fx = w.fx, fy = w.fy, fz = w.fz;
  const SliceDifferences s0 = slice_differences(w.slice0, fx, fy), s1 = slice_differences(w.slice1, fx, fy);
  const floatN mean_before = mix_four(BYTE(w.before, 0u), BYTE(w.before, 2u), BYTE(w.before, 1u), BYTE(w.before, 3u),
                                      fx, fy);
  const floatN mean_behind = mix_four(BYTE(w.behind, 0u), BYTE(w.behind, 2u), BYTE(w.behind, 1u), BYTE(w.behind, 3u),
                                      fx, fy);
  const floatN mean0 = mix_corners(s0.m0, s0.m1, fy), mean1 = mix_corners(s1.m0, s1.m1, fy);
  const Gradient g = {0.5f * mix_corners(s0.dx, s1.dx, fz), 0.5f * mix_corners(s0.dy, s1.dy, fz),
                      0.5f * mix_corners(mean1 - mean_before, mean_behind - mean0, fz)};
  return g;
}

/* The same at the volume's faces, where differences are over one voxel instead of two: they count twice. All else is in
 * the order of gradient_of_words(), so that a lane that is not at a face gets the same bits from either, whatever its
 * neighbours are. */
INLINE Gradient face_gradient(__global const uchar *volume, __constant const View *view, Place x, Place y, Place z)
{
  const intN first_x = MASK(x.index == 0), last_x = MASK(x.index == view->size.x - 2);
  const intN first_y = MASK(y.index == 0), last_y = MASK(y.index == view->size.y - 2);
  const intN first_z = MASK(z.index == 0), last_z = MASK(z.index == view->size.z - 2);
  const intN zero = 0, one = 1;
  const intN low_x = x.index - select(one, zero, first_x), high_x = x.index + select(one, zero, last_x);
  const intN low_y = y.index - select(one, zero, first_y), high_y = y.index + select((intN)2, one, last_y);
  const intN low_z = z.index - select(one, zero, first_z), high_z = z.index + select((intN)2, one, last_z);
  const floatN once = 1.0f, twice = 2.0f;
  const floatN x0 = select(once, twice, first_x), x1 = select(once, twice, last_x);
  const floatN y0 = select(once, twice, first_y), y1 = select(once, twice, last_y);
  floatN dx[2], dy[2], mean[2];
  _Pragma("unroll 1") for (int k = 0; k < 2; ++k) {
    const intN iz = z.index + k;
    floatN b[2], c[2], at_x0[2], at_x1[2]; /* of rows y and y + 1 */
    for (int j = 0; j < 2; ++j) {
      const Edge low = fetch_edge(volume, view, low_x, y.index + j, iz);
      const Edge high = fetch_edge(volume, view, high_x, y.index + j, iz);
      b[j] = select(low.v1, low.v0, first_x), c[j] = select(high.v0, high.v1, last_x);
      at_x0[j] = c[j] - low.v0, at_x1[j] = high.v1 - b[j];
    }
    dx[k] = mix_corners(mix_corners(at_x0[0], at_x0[1], y.f) * x0, mix_corners(at_x1[0], at_x1[1], y.f) * x1, x.f);
    const floatN m0 = mix_corners(b[0], c[0], x.f), m1 = mix_corners(b[1], c[1], x.f);
    const floatN above = mix_edge(fetch_edge(volume, view, x.index, low_y, iz), x.f);
    const floatN below = mix_edge(fetch_edge(volume, view, x.index, high_y, iz), x.f);
    dy[k] = mix_corners((m1 - above) * y0, (below - m0) * y1, y.f);
    mean[k] = mix_corners(m0, m1, y.f);
  }
  const floatN before = mix_face(fetch_face(volume, view, x.index, y.index, low_z), x.f, y.f);
  const floatN behind = mix_face(fetch_face(volume, view, x.index, y.index, high_z), x.f, y.f);
  const Gradient g = {0.5f * mix_corners(dx[0], dx[1], z.f), 0.5f * mix_corners(dy[0], dy[1], z.f),
                      0.5f * mix_corners((mean[1] - before) * select(once, twice, first_z),
                                         (behind - mean[0]) * select(once, twice, last_z), z.f)};
  return g;
}

#endif

INLINE intN beside_faces(Place p, int size) { return MASK(p.index == 0) | MASK(p.index == size - 2); }

INLINE Gradient gradient_at(__global const uchar *volume, __global const uint *gradients, __constant const View *view,
                            float4 gradient_scale, floatN px, floatN py, floatN pz)
{
  const Place x = place_in_cell(px, view->upper.x, view->size.x), y = place_in_cell(py, view->upper.y, view->size.y);
  const Place z = place_in_cell(pz, view->upper.z, view->size.z);
#if VOXEL_BITS == 8 && VOXEL_PAIRS && !OWNED_BOX
  const intN beside = beside_faces(x, view->size.x) | beside_faces(y, view->size.y) | beside_faces(z, view->size.z);
  return any_lane(beside) ? face_gradient(volume, view, x, y, z)
                          : gradient_of_words(fetch_gradient(volume, view, x, y, z));
#else
  return finite_gradient(central_gradient(volume, view, x, y, z));
#endif
}

#elif GRADIENT == GRADIENT_PRECOMPUTED

/* Bytes 0, 1, 2 times the square of byte 3: the sum of the eight, times its weight each. */
INLINE void add_stored(Gradient *g, intN *bad, uintN word, floatN weight)
{
  const intN w = AS_INT(word);
  const floatN root = TO_FLOAT(AS_INT(word >> 24u)), share = weight * root * root;
  g->x += share * TO_FLOAT(w << 24 >> 24), g->y += share * TO_FLOAT(w << 16 >> 24),
      g->z += share * TO_FLOAT(w << 8 >> 24);
#if VOXEL_HOLES
  *bad |= MASK((w & 255) == 128) & MASK(weight != 0.0f);
#endif
}

INLINE Gradient gradient_at(__global const uchar *volume, __global const uint *gradients, __constant const View *view,
                            float4 gradient_scale, floatN px, floatN py, floatN pz)
{
  const Place x = place_in_cell(px, view->upper.x, view->size.x), y = place_in_cell(py, view->upper.y, view->size.y);
  const Place z = place_in_cell(pz, view->upper.z, view->size.z);
  const int row = view->size.x, slice = view->size.x * view->size.y;
  Gradient g = {0.0f, 0.0f, 0.0f};
  intN bad = 0;
#if FILTER == FILTER_NEAREST
  const intN at = (z.index + TO_INT(z.f)) * slice + (y.index + TO_INT(y.f)) * row + x.index + TO_INT(x.f);
  add_stored(&g, &bad, gather4(gradients, at), (floatN)1.0f);
#else
  const intN at = z.index * slice + y.index * row + x.index;
  __global const uint *behind = gradients + slice;
  uintN g000, g100, g010, g110, g001, g101, g011, g111;
  gather_two4(gradients, at, &g000, &g100), gather_two4(gradients + row, at, &g010, &g110);
  gather_two4(behind, at, &g001, &g101), gather_two4(behind + row, at, &g011, &g111);
  const floatN w11 = y.f * z.f, w01 = z.f - w11, w10 = y.f - w11, w00 = 1.0f - z.f - w10;
  const floatN x0 = 1.0f - x.f;
  add_stored(&g, &bad, g000, x0 * w00), add_stored(&g, &bad, g100, x.f * w00);
  add_stored(&g, &bad, g010, x0 * w10), add_stored(&g, &bad, g110, x.f * w10);
  add_stored(&g, &bad, g001, x0 * w01), add_stored(&g, &bad, g101, x.f * w01);
  add_stored(&g, &bad, g011, x0 * w11), add_stored(&g, &bad, g111, x.f * w11);
#endif
  const floatN zero = 0.0f;
  g.x = select(g.x * gradient_scale.x, zero, bad), g.y = select(g.y * gradient_scale.y, zero, bad);
  g.z = select(g.z * gradient_scale.z, zero, bad);
  return g;
}

#elif GRADIENT == GRADIENT_ANALYTIC && KERNEL_FILTER

INLINE Gradient gradient_at(__global const uchar *volume, __global const uint *gradients, __constant const View *view,
                            float4 gradient_scale, floatN px, floatN py, floatN pz)
{
  const FetchedSample at = fetch_kernel(volume, view, px, py, pz);
  const KernelSample s = kernel_sample(volume, view, &at.x, &at.y, &at.z, 1);
  const Gradient g = {s.x, s.y, s.z};
  return finite_gradient(g);
}

#else

/* An axis of four voxels: their weights in a mean along it, and in the derivative along it, which add up to 0. */
typedef struct {
  SplineAxis mean, slope;
} GradientAxis;

#if GRADIENT == GRADIENT_SOBEL

INLINE GradientAxis gradient_axis(floatN x, float upper, int size)
{
  const Place p = place_in_cell(x, upper, size);
  const intN first = MASK(p.index == 0), last = MASK(p.index == size - 2);
  const floatN u = p.f, v = 1.0f - u, whole = 1.0f, part = 0.5f;
  const floatN low = v * select(part, whole, first), high = u * select(part, whole, last);
  GradientAxis a;
  a.mean = axis_in_blocks(p.index, first, last, 0.25f * v, 0.25f * (1.0f + v), 0.25f * (1.0f + u), 0.25f * u);
  a.slope = axis_in_blocks(p.index, first, last, -low, -high, low, high);
  return a;
}

#elif GRADIENT == GRADIENT_ANALYTIC && WIDE_FILTER

INLINE GradientAxis gradient_axis(floatN x, float upper, int size)
{
  x = lane_clamp(x, (floatN)0.0f, (floatN)upper);
  const intN index = cell_index(x, size);
  const floatN u = x - TO_FLOAT(index), v = 1.0f - u;
  GradientAxis a;
  a.mean = spline_axis(x, size);
  const intN first = MASK(a.mean.low == index), last = MASK(a.mean.high == index);
#if FILTER == FILTER_CUBIC
  a.slope = axis_in_blocks(index, first, last, -0.5f * v * v, u * (1.5f * u - 2.0f), v * (2.0f - 1.5f * v),
                           0.5f * u * u);
#else
  const floatN d1 = u * (4.5f * u - 5.0f), d2 = v * (5.0f - 4.5f * v);
  a.slope = axis_in_blocks(index, first, last, v * (u - 0.5f * v), d1, d2, u * (0.5f * u - v));
#endif
  return a;
}

#else
#error "GRADIENT is unknown, or not for this filter"
#endif

/* A row of four voxels along x, its mean and derivative. Without holes both count from the second voxel, so that a
 * constant field has exactly no derivative. */
INLINE floatN row_mean(floatN p0, floatN p1, floatN p2, floatN p3, SplineAxis a)
{
#if VOXEL_HOLES
  const BasedSum s = based_sum(p0, p1, p2, p3, a);
  return s.base + s.sum;
#else
  return p1 + (a.w0 * (p0 - p1) + a.w2 * (p2 - p1) + a.w3 * (p3 - p1));
#endif
}

INLINE floatN row_slope(floatN p0, floatN p1, floatN p2, floatN p3, SplineAxis a)
{
#if VOXEL_HOLES
  return based_sum(p0, p1, p2, p3, a).sum;
#else
  return a.w0 * (p0 - p1) + a.w2 * (p2 - p1) + a.w3 * (p3 - p1);
#endif
}

/* To the derivative across the rows a row's mean, to that along them its slope. */
INLINE void add_mean(BasedSum *s, floatN weight, floatN value)
{
#if VOXEL_HOLES
  add_weighted(s, weight, value);
#else
  s->sum += weight * (value - s->base);
#endif
}

INLINE void add_slope(BasedSum *s, floatN weight, floatN slope)
{
#if VOXEL_HOLES
  slope = select(slope, (floatN)0.0f, MASK(weight == 0.0f));
#endif
  s->sum += weight * slope;
}

/* Four times four rows along x, in a loop, because compilers take minutes over the straight line. */
INLINE Gradient gradient_at(__global const uchar *volume, __global const uint *gradients, __constant const View *view,
                            float4 gradient_scale, floatN px, floatN py, floatN pz)
{
  const GradientAxis x = gradient_axis(px, view->upper.x, view->size.x);
  const GradientAxis y = gradient_axis(py, view->upper.y, view->size.y);
  const GradientAxis z = gradient_axis(pz, view->upper.z, view->size.z);
  BasedSum along_x = {0.0f, 0.0f, 0}, along_y = {0.0f, 0.0f, 0}, along_z = {0.0f, 0.0f, 0};
  _Pragma("unroll 1") for (int block = 0; block < 4; ++block) {
    const int behind = block >> 1, below = block & 1;
    const intN iy = below ? y.mean.high : y.mean.low, iz = behind ? z.mean.high : z.mean.low;
    const Corners a = decode_corners(fetch_corners(volume, view, x.mean.low, iy, iz), view);
    const Corners b = decode_corners(fetch_corners(volume, view, x.mean.high, iy, iz), view);
    const floatN my[2] = {below ? y.mean.w2 : y.mean.w0, below ? y.mean.w3 : y.mean.w1};
    const floatN mz[2] = {behind ? z.mean.w2 : z.mean.w0, behind ? z.mean.w3 : z.mean.w1};
    const floatN sy[2] = {below ? y.slope.w2 : y.slope.w0, below ? y.slope.w3 : y.slope.w1};
    const floatN sz[2] = {behind ? z.slope.w2 : z.slope.w0, behind ? z.slope.w3 : z.slope.w1};
#define ADD_ROW(Y, Z)                                                                                        \
  {                                                                                                          \
    const floatN mean_ = row_mean(a.v0##Y##Z, a.v1##Y##Z, b.v0##Y##Z, b.v1##Y##Z, x.mean);                   \
    const floatN slope_ = row_slope(a.v0##Y##Z, a.v1##Y##Z, b.v0##Y##Z, b.v1##Y##Z, x.slope);                \
    if (!VOXEL_HOLES && block == 0 && Y == 0 && Z == 0) along_y.base = along_z.base = mean_;                 \
    add_slope(&along_x, my[Y] * mz[Z], slope_);                                                              \
    add_mean(&along_y, sy[Y] * mz[Z], mean_);                                                                \
    add_mean(&along_z, my[Y] * sz[Z], mean_);                                                                \
  }
    ADD_ROW(0, 0)
    ADD_ROW(1, 0)
    ADD_ROW(0, 1)
    ADD_ROW(1, 1)
#undef ADD_ROW
  }
  const Gradient g = {along_x.sum, along_y.sum, along_z.sum};
  return finite_gradient(g);
}

#endif

#endif
