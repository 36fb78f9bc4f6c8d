/* Gradients at the voxels, central differences or Sobel's (gradient.h), in four bytes each: a direction of three
 * signed bytes x, y, z (bits 0, 8, 16), and as byte 3 the square root of a length over the largest one (Ljung 2006).
 *
 * Where this differs from Ljung: lengths are those of the largest component, and the root is rounded up, so that a
 * direction need not be of unit length: component = (byte 3 / 255)^2 * largest * (direction / 127). What rounding the
 * length is wrong by the direction makes up for: a component is off by at most 1/254 of the largest of the three, and
 * a little for short ones. Byte 0 is -128 where the gradient is not finite.
 *
 * Axes are scaled alike in the world, so that directions are as good across the long edges of a voxel as along them.
 *
 * Switches (-D): VOXEL_BITS, VOXEL_SIGNED, SOBEL.
 */
#include "voxel_type.h"

#if VOXEL_BITS == 64
typedef double Real;
typedef double4 Real4;
#else
typedef float Real;
typedef float4 Real4;
#endif

/* A column of voxels, [z - 1 ... z + 1, y - 1 ... y + 1] at one x: the smoothed value and the derivatives along y and
 * z. Rows and slices beyond the volume are its outermost ones, where differences are over one voxel: factors `over` of
 * y and z. */
typedef struct {
  Real value, dy, dz;
} Column;

typedef struct {
  __global const Voxel *rows[3][3]; /* [z][y] */
  Real over_y, over_z, before;      /* voxels are multiplied by `before` first: then no difference overflows */
} Rows;

static Rows rows_around(__global const Voxel *volume, int4 size, int y, int z, Real before)
{
  Rows r;
  const int below = min(y + 1, size.y - 1), above = max(y - 1, 0), behind = min(z + 1, size.z - 1);
  const int front = max(z - 1, 0);
  const int ys[3] = {above, y, below}, zs[3] = {front, z, behind};
  for (int k = 0; k < 3; ++k)
    for (int j = 0; j < 3; ++j) r.rows[k][j] = volume + ((size_t)zs[k] * size.y + ys[j]) * size.x;
  r.over_y = (Real)1 / (below - above), r.over_z = (Real)1 / (behind - front), r.before = before;
  return r;
}

static Column column_at(const Rows *r, int x)
{
  Column c;
#if SOBEL
  Real v[3][3];
  for (int k = 0; k < 3; ++k)
    for (int j = 0; j < 3; ++j) v[k][j] = (Real)r->rows[k][j][x] * r->before;
  const Real q = (Real)0.25, h = (Real)0.5;
  Real mean[3];
  for (int k = 0; k < 3; ++k) mean[k] = h * v[k][1] + q * (v[k][0] + v[k][2]);
  c.value = h * mean[1] + q * (mean[0] + mean[2]);
  c.dz = (mean[2] - mean[0]) * r->over_z;
  c.dy = (h * (v[1][2] - v[1][0]) + q * ((v[0][2] - v[0][0]) + (v[2][2] - v[2][0]))) * r->over_y;
#else
  c.value = (Real)r->rows[1][1][x] * r->before;
  c.dy = ((Real)r->rows[1][2][x] * r->before - (Real)r->rows[1][0][x] * r->before) * r->over_y;
  c.dz = ((Real)r->rows[2][1][x] * r->before - (Real)r->rows[0][1][x] * r->before) * r->over_z;
#endif
  return c;
}

/* `to` carries derivatives to the metric. */
static float4 gradient_between(Column left, Column here, Column right, Real over, Real4 to)
{
#if SOBEL
  const Real q = (Real)0.25, h = (Real)0.5;
  const Real dy = h * here.dy + q * (left.dy + right.dy), dz = h * here.dz + q * (left.dz + right.dz);
#else
  const Real dy = here.dy, dz = here.dz;
#endif
  return (float4)((float)((right.value - left.value) * over * to.x), (float)(dy * to.y), (float)(dz * to.z), 0.0f);
}

/* Along a row of voxels from its start. */
typedef struct {
  Rows rows;
  Column left, here; /* the first column counts twice, and so does the last one */
  int last;
} Walk;

static Walk start_row(__global const Voxel *volume, int4 size, Real4 metric)
{
  Walk w;
  w.rows = rows_around(volume, size, get_global_id(0), get_global_id(1), metric.w);
  w.left = w.here = column_at(&w.rows, 0);
  w.last = size.x - 1;
  return w;
}

/* The gradient at x, which is next, and its largest component: -1 where it is not finite. */
static float4 next_gradient(Walk *w, int x, Real4 metric)
{
  const Column right = column_at(&w->rows, min(x + 1, w->last));
  const int at_end = x == 0 || x == w->last;
  float4 g = gradient_between(w->left, w->here, right, at_end ? (Real)1 : (Real)0.5, metric);
  const int is_finite = isfinite(g.x) && isfinite(g.y) && isfinite(g.z);
  g.w = is_finite ? fmax(fmax(fabs(g.x), fabs(g.y)), fabs(g.z)) : -1.0f;
  w->left = w->here, w->here = right;
  return g;
}

static uint direction_byte(float component, float unit)
{
  return (uint)((int)clamp(rint(component * unit), -127.0f, 127.0f) & 255);
}

static uint gradient_code(float4 g, float largest)
{
  if (g.w < 0.0f) return 0x80u;
  if (g.w == 0.0f) return 0u;
  const float root = clamp(ceil(255.0f * sqrt(g.w / largest)), 1.0f, 255.0f);
  const float unit = 127.0f / (largest * (root / 255.0f) * (root / 255.0f));
  return direction_byte(g.x, unit) | direction_byte(g.y, unit) << 8 | direction_byte(g.z, unit) << 16 |
      (uint)root << 24;
}

/* Of each row of voxels the largest component of a finite gradient.
 *
 * volume  Voxel [size.z, size.y, size.x]
 * metric  Real [4]: what derivatives along x, y, z are multiplied by, and voxels before that
 * largest float [size.z, size.y]
 */
__kernel void largest_gradients(__global const Voxel *restrict volume, int4 size, __global const Real4 *restrict metric,
                                __global float *restrict largest)
{
  float most = 0.0f;
  Walk row = start_row(volume, size, metric[0]);
  for (int x = 0; x < size.x; ++x) most = fmax(most, next_gradient(&row, x, metric[0]).w);
  largest[(size_t)get_global_id(1) * size.y + get_global_id(0)] = most;
}

/* codes uint [size.z, size.y, size.x]; `largest` of all components. */
__kernel void store_gradients(__global const Voxel *restrict volume, int4 size, __global const Real4 *restrict metric,
                              float largest, __global uint *restrict codes)
{
  __global uint *out = codes + ((size_t)get_global_id(1) * size.y + get_global_id(0)) * size.x;
  Walk row = start_row(volume, size, metric[0]);
  for (int x = 0; x < size.x; ++x) out[x] = gradient_code(next_gradient(&row, x, metric[0]), largest);
}
