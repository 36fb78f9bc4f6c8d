/* Bricks of a volume for rays (fetch_voxel.h, BRICKS), made of blocks as they are decoded or read; and the bounds of
 * their values.
 *
 * A brick holds the voxels of a block of EDGE^3 and one further plane behind each of its upper faces, so that all cells
 * that begin in the block are whole. Rows have EDGE + 1 elements. Of 8 bits each element is a pair, of a voxel and the
 * next one in y; then slices have EDGE rows, else EDGE + 1.
 *
 * Switches (-D): VOXEL_BITS, VOXEL_SIGNED, VOXEL_PAIRS, BRICKS (log2 of EDGE).
 */
#include "voxel_type.h"

#define EDGE (1 << BRICKS)
#define PITCH (EDGE + 1)
#define ROWS (VOXEL_PAIRS ? EDGE : EDGE + 1)
#define STEP (VOXEL_PAIRS ? 2 : 1)

#if VOXEL_BITS >= 32
#define IS_VALUE(v) isfinite(v)
#else
#define IS_VALUE(v) 1
#endif

#define WANTED 12

/* A work-item takes one slice of one brick.
 *
 * wanted  int [bricks, WANTED]: element of `volume` where the brick begins; which of `blocks` are its own block and those
 *         behind its upper faces, [dz][dy][dx], -1 beyond the volume; and how many of the brick's voxels along x, y and z
 *         are in the volume, whose last ones repeat beyond it, whatever the block holds there
 * blocks  Voxel [., EDGE, EDGE, EDGE]
 * volume  what rays sample: the table, then bricks
 */
__kernel void fill_bricks(__global const int *restrict wanted, int bricks, __global const Voxel *restrict blocks,
                          __global uchar *restrict volume)
{
  const int slice = get_global_id(0), brick = get_global_id(1);
  if (brick >= bricks || slice > EDGE) return;
  __global const int *from = wanted + WANTED * brick + 1;
  const int nx = min(from[8], EDGE), ny = from[9], nz = from[10];
  __global Voxel *out = (__global Voxel *)volume + STEP * ((size_t)from[-1] + slice * (ROWS * PITCH));
  const int over_z = slice == EDGE && from[4] >= 0, z = over_z ? 0 : min(slice, min(nz, EDGE) - 1);
  for (int y = 0; y <= EDGE; ++y) {
    const int over_y = y == EDGE && from[2] >= 0, row = over_y ? 0 : min(y, min(ny, EDGE) - 1);
    const int here = 4 * over_z + 2 * over_y, place = (z * EDGE + row) * EDGE;
    __global const Voxel *in = blocks + (size_t)from[here] * (EDGE * EDGE * EDGE) + place;
    const int far = from[here + 1];
    const Voxel last = in[nx - 1], end = far < 0 ? last : blocks[(size_t)far * (EDGE * EDGE * EDGE) + place];
#if VOXEL_PAIRS
    /* As the first voxels of this row's pairs, and as the second ones of those of the row before. */
    for (int second = y == EDGE; second <= (y > 0); ++second) {
      __global Voxel *to = out + 2 * (y - second) * PITCH + second;
      for (int x = 0; x < nx; ++x) to[2 * x] = in[x];
      for (int x = nx; x < EDGE; ++x) to[2 * x] = last;
      to[2 * EDGE] = end;
    }
#else
    __global Voxel *to = out + y * PITCH;
    for (int x = 0; x < nx; ++x) to[x] = in[x];
    for (int x = nx; x < EDGE; ++x) to[x] = last;
    to[EDGE] = end;
#endif
  }
}

/* As min_max_cells() of empty_space.cl with an apron of 0, for the cells of 2^shift voxels, at most EDGE, of bricks.
 * A work-item takes one brick.
 *
 * bounds  Voxel [bricks, n, n, n, 2], n = EDGE >> shift
 */
__kernel void brick_bounds(__global const int *restrict wanted, int bricks, int shift,
                           __global const uchar *restrict volume, __global Voxel *restrict bounds)
{
  const int brick = get_global_id(0);
  if (brick >= bricks) return;
  const int n = EDGE >> shift, edge = 1 << shift;
  __global const Voxel *in = (__global const Voxel *)volume + STEP * (size_t)wanted[WANTED * brick];
  for (int cell = 0; cell < n * n * n; ++cell) {
    const int x0 = cell % n << shift, y0 = cell / n % n << shift, z0 = cell / (n * n) << shift;
    Voxel low = 1, high = 0;
    int any_value = 0;
    for (int z = z0; z <= z0 + edge; ++z)
      for (int y = y0; y <= y0 + edge; ++y) {
        const int second = VOXEL_PAIRS && y == EDGE; /* the last row is only there as the second one of pairs */
        __global const Voxel *row = in + STEP * ((z * ROWS + y - second) * PITCH) + second;
        for (int x = x0; x <= x0 + edge; ++x) {
          const Voxel v = row[STEP * x];
          if (!IS_VALUE(v)) continue;
          low = any_value && low < v ? low : v;
          high = any_value && high > v ? high : v;
          any_value = 1;
        }
      }
    __global Voxel *out = bounds + 2 * ((size_t)brick * n * n * n + cell);
    out[0] = low, out[1] = high;
  }
}
