/* Filters of any separable kernel: the weights are polynomials between two voxels (clvol/features/kernels.py), of
 * KERNEL_BLOCKS voxels before the place and as many behind it along each axis, which mirror them.
 *
 *   mitchell       Mitchell and Netravali 1988: between blurring and ringing             64 voxels
 *   lanczos2       Duchon 1979                                                           64
 *   lanczos3                                                                            216
 *   windowed-sinc  Marschner and Lobb 1994                                              216
 *   table          of the scene                                                         216
 *
 * Beyond the volume its outermost voxels count: there a block of two moves inwards, and its weights fall on one voxel.
 * Negative weights overshoot: overshoot() of clvol/features/vocabulary.py has by how much.
 */
#ifndef KERNEL_FILTER_H
#define KERNEL_FILTER_H

#include "features.h"
#include "fetch_voxel.h"
#include "lanes.h"
#include "view.h"

#define KERNEL_BLOCKS (FILTER == FILTER_MITCHELL || FILTER == FILTER_LANCZOS2 ? 2 : 3)
#define MOST_KERNEL_BLOCKS 3
#define KERNEL_TAPS (2 * KERNEL_BLOCKS)
#define KERNEL_TERMS 3 /* float4 per polynomial */

typedef struct {
  intN at[MOST_KERNEL_BLOCKS];                                             /* where blocks of two voxels begin */
  floatN w[2 * MOST_KERNEL_BLOCKS], slope[2 * MOST_KERNEL_BLOCKS];         /* of their voxels; its derivative */
} KernelAxis;

/* The polynomial of tap k at u, and its derivative. */
INLINE floatN kernel_weight(__constant const View *view, int k, floatN u, floatN *slope)
{
  floatN value = 0.0f, derivative = 0.0f;
  _Pragma("unroll 1") for (int j = KERNEL_TERMS - 1; j >= 0; --j) {
    const float4 c = view->filter_terms[KERNEL_TERMS * k + j];
    derivative = derivative * u + value, value = value * u + c.w;
    derivative = derivative * u + value, value = value * u + c.z;
    derivative = derivative * u + value, value = value * u + c.y;
    derivative = derivative * u + value, value = value * u + c.x;
  }
  *slope = derivative;
  /* There a weight may be 0, exactly. */
  const float end = k > 0 ? view->filter_terms[KERNEL_TERMS * (k - 1)].x : 0.0f;
  return select(value, (floatN)end, MASK(u == 1.0f));
}

INLINE KernelAxis kernel_axis(__constant const View *view, floatN x, float upper, int size)
{
  x = lane_clamp(x, (floatN)0.0f, (floatN)upper);
  const intN index = min(TO_INT(x), (intN)(size - 2));
  const floatN u = x - TO_FLOAT(index), v = 1.0f - u, zero = 0.0f;
  KernelAxis a;
  _Pragma("unroll 1") for (int k = 0; k < KERNEL_BLOCKS; ++k) {
    floatN slope;
    a.w[k] = kernel_weight(view, k, u, &slope), a.slope[k] = slope;
    a.w[KERNEL_TAPS - 1 - k] = kernel_weight(view, k, v, &slope), a.slope[KERNEL_TAPS - 1 - k] = -slope;
  }
  _Pragma("unroll 1") for (int b = 0; b < KERNEL_BLOCKS; ++b) {
    const intN start = index + (2 * b + 1 - KERNEL_BLOCKS);
    const intN before = MASK(start < 0), behind = MASK(start > size - 2);
    const floatN both = a.w[2 * b] + a.w[2 * b + 1], slopes = a.slope[2 * b] + a.slope[2 * b + 1];
    a.at[b] = min(max(start, (intN)0), (intN)(size - 2));
    a.w[2 * b] = select(select(a.w[2 * b], both, before), zero, behind);
    a.w[2 * b + 1] = select(select(a.w[2 * b + 1], zero, before), both, behind);
    a.slope[2 * b] = select(select(a.slope[2 * b], slopes, before), zero, behind);
    a.slope[2 * b + 1] = select(select(a.slope[2 * b + 1], zero, before), slopes, behind);
  }
  return a;
}

/* The value, and its derivatives per lattice unit. */
typedef struct {
  floatN value, x, y, z;
} KernelSample;

/* Sums over all voxels, counted from one that has weight, so that a constant field is exact. */
#if VOXEL_HOLES

/* What has weight 0 does not count, even if it is not finite; what has, and is not, makes all of it so. */
INLINE floatN weighted_step(floatN weight, floatN value, floatN base)
{
  return select((floatN)0.0f, weight * (value - base), MASK(weight != 0.0f));
}

INLINE KernelSample kernel_sample(__global const uchar *volume, __constant const View *view, const KernelAxis *x,
                                  const KernelAxis *y, const KernelAxis *z, int derivatives)
{
  KernelSample s = {0.0f, 0.0f, 0.0f, 0.0f};
  floatN base = 0.0f;
  _Pragma("unroll 1") for (int pass = 0; pass < 2; ++pass) { /* the base first: a finite voxel that counts */
    _Pragma("unroll 1") for (int block = 0; block < KERNEL_BLOCKS * KERNEL_BLOCKS * KERNEL_BLOCKS; ++block) {
      const int bx = block % KERNEL_BLOCKS, by = block / KERNEL_BLOCKS % KERNEL_BLOCKS;
      const int bz = block / (KERNEL_BLOCKS * KERNEL_BLOCKS);
      const Corners p = decode_corners(fetch_corners(volume, view, x->at[bx], y->at[by], z->at[bz]), view);
      const floatN corner[8] = {p.v000, p.v100, p.v010, p.v110, p.v001, p.v101, p.v011, p.v111};
      _Pragma("unroll 1") for (int v = 0; v < 8; ++v) {
        const int i = 2 * bx + (v & 1), j = 2 * by + (v >> 1 & 1), k = 2 * bz + (v >> 2);
        const floatN weight = x->w[i] * y->w[j] * z->w[k];
        if (pass == 0) {
          base = select(base, corner[v], MASK(base == 0.0f) & MASK(weight != 0.0f) & finite_lanes(corner[v]));
          continue;
        }
        s.value += weighted_step(weight, corner[v], base);
        if (!derivatives) continue;
        s.x += weighted_step(x->slope[i] * y->w[j] * z->w[k], corner[v], base);
        s.y += weighted_step(x->w[i] * y->slope[j] * z->w[k], corner[v], base);
        s.z += weighted_step(x->w[i] * y->w[j] * z->slope[k], corner[v], base);
      }
    }
  }
  s.value += base;
  return s;
}

#else

/* Rows along x first. */
INLINE KernelSample kernel_sample(__global const uchar *volume, __constant const View *view, const KernelAxis *x,
                                  const KernelAxis *y, const KernelAxis *z, int derivatives)
{
  KernelSample s = {0.0f, 0.0f, 0.0f, 0.0f};
  floatN base = 0.0f;
  _Pragma("unroll 1") for (int c = 0; c < KERNEL_BLOCKS * KERNEL_BLOCKS; ++c) {
    const int bz = c / KERNEL_BLOCKS, by = c - bz * KERNEL_BLOCKS;
    floatN m00 = 0.0f, m10 = 0.0f, m01 = 0.0f, m11 = 0.0f, d00 = 0.0f, d10 = 0.0f, d01 = 0.0f, d11 = 0.0f;
    _Pragma("unroll 1") for (int bx = 0; bx < KERNEL_BLOCKS; ++bx) {
      const Corners p = decode_corners(fetch_corners(volume, view, x->at[bx], y->at[by], z->at[bz]), view);
      if (c == 0 && bx == 0) base = p.v000;
      const floatN w = x->w[2 * bx], w1 = x->w[2 * bx + 1];
      m00 += w * (p.v000 - base) + w1 * (p.v100 - base), m10 += w * (p.v010 - base) + w1 * (p.v110 - base);
      m01 += w * (p.v001 - base) + w1 * (p.v101 - base), m11 += w * (p.v011 - base) + w1 * (p.v111 - base);
      if (!derivatives) continue;
      const floatN g = x->slope[2 * bx], g1 = x->slope[2 * bx + 1];
      d00 += g * (p.v000 - base) + g1 * (p.v100 - base), d10 += g * (p.v010 - base) + g1 * (p.v110 - base);
      d01 += g * (p.v001 - base) + g1 * (p.v101 - base), d11 += g * (p.v011 - base) + g1 * (p.v111 - base);
    }
    const floatN y0 = y->w[2 * by], y1 = y->w[2 * by + 1], z0 = z->w[2 * bz], z1 = z->w[2 * bz + 1];
    const floatN near = y0 * m00 + y1 * m10, far = y0 * m01 + y1 * m11;
    s.value += z0 * near + z1 * far;
    if (!derivatives) continue;
    const floatN gy0 = y->slope[2 * by], gy1 = y->slope[2 * by + 1];
    s.x += z0 * (y0 * d00 + y1 * d10) + z1 * (y0 * d01 + y1 * d11);
    s.y += z0 * (gy0 * m00 + gy1 * m10) + z1 * (gy0 * m01 + gy1 * m11);
    s.z += z->slope[2 * bz] * near + z->slope[2 * bz + 1] * far;
  }
  s.value += base;
  return s;
}

#endif

typedef struct {
  __global const uchar *volume;
  KernelAxis x, y, z;
} FetchedSample;

INLINE FetchedSample fetch_kernel(__global const uchar *volume, __constant const View *view, floatN x, floatN y,
                                  floatN z)
{
  FetchedSample s;
  s.volume = volume;
  s.x = kernel_axis(view, x, view->upper.x, view->size.x);
  s.y = kernel_axis(view, y, view->upper.y, view->size.y);
  s.z = kernel_axis(view, z, view->upper.z, view->size.z);
  return s;
}

INLINE floatN kernel_value(FetchedSample s, __constant const View *view)
{
  return kernel_sample(s.volume, view, &s.x, &s.y, &s.z, 0).value;
}

#endif
