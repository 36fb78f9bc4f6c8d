/* How much a volume's field bends and rises in each cell of 4^3 lattice points: what bounds the error of a segment of
 * several steps (clvol/integrators/raycast/step_map.py). Along a unit direction (in voxels) a trilinear field's slope
 * changes by at most its second differences at the faces of lattice cells, and by twice its mixed differences inside.
 *
 * Switches (-D): VOXEL_BITS, VOXEL_SIGNED.
 */
#include "voxel_type.h"

#define CELL 4

/* 16 voxels of a row of n from x on; those beyond its ends are its outermost ones. */
inline float16 voxels16(__global const Voxel *row, int x, int n)
{
  if (x >= 0 && x + 16 <= n) return convert_float16(vload16(0, row + x));
  float each[16];
  for (int k = 0; k < 16; ++k) each[k] = (float)row[clamp(x + k, 0, n - 1)];
  return vload16(0, each);
}

inline float16 larger(float16 a, float16 b) { return select(a, b, b > a); }

inline float16 largest_of(float16 a, float16 b, float16 c) { return larger(larger(fabs(a), fabs(b)), fabs(c)); }

/* A row of cells per work-item.
 * cells  float2 [((n - 1) / 4 + 1) for each axis z, y, x]: largest curvature (value per voxel^2) and slope (per voxel) at
 *        the lattice points of the cell, towards the next ones
 */
__kernel void cell_curvature(__global const Voxel *restrict volume, int4 size, __global float2 *restrict cells)
{
  const int cy = get_global_id(0), cz = get_global_id(1);
  const int columns = (size.x - 1) / CELL + 1, rows = (size.y - 1) / CELL + 1;
  for (int x = 0; x < size.x; x += 16) {
    float16 curvature = 0.0f, slope = 0.0f;
    for (int z = cz * CELL; z < min(cz * CELL + CELL, size.z); ++z)
      for (int y = cy * CELL; y < min(cy * CELL + CELL, size.y); ++y) {
        const int down = max(y - 1, 0), up = min(y + 1, size.y - 1), near = max(z - 1, 0), far = min(z + 1, size.z - 1);
#define ROW(slice, row) (volume + ((size_t)(slice) * size.y + (row)) * size.x)
        const float16 v = voxels16(ROW(z, y), x, size.x);
        const float16 vx = voxels16(ROW(z, y), x + 1, size.x), vy = voxels16(ROW(z, up), x, size.x);
        const float16 vz = voxels16(ROW(far, y), x, size.x);
        const float16 dx = vx - v, dy = vy - v, dz = vz - v;
        const float16 second = largest_of(dx - v + voxels16(ROW(z, y), x - 1, size.x),
                                          dy - v + voxels16(ROW(z, down), x, size.x),
                                          dz - v + voxels16(ROW(near, y), x, size.x));
        const float16 mixed = largest_of(voxels16(ROW(z, up), x + 1, size.x) - vx - dy,
                                         voxels16(ROW(far, up), x, size.x) - vy - dz,
                                         voxels16(ROW(far, y), x + 1, size.x) - vz - dx);
        curvature = larger(curvature, second + 2.0f * mixed);
        slope = larger(slope, largest_of(dx, dy, dz));
      }
    float bends[16], rises[16];
    vstore16(curvature, 0, bends), vstore16(slope, 0, rises);
    for (int k = 0; k < 16 && x + k < size.x; k += CELL) {
      float2 most = (float2)(0.0f, 0.0f);
      for (int j = k; j < k + CELL; ++j) most = fmax(most, (float2)(bends[j], rises[j]));
      cells[((size_t)cz * rows + cy) * columns + (x + k) / CELL] = most;
    }
  }
}
