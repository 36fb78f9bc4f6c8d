/* Empty space of a volume of blocks: which cells can show anything, from the samples that are resident. Cells are
 * cubes of 2^shift voxels, in places p of blocks.h, and lie within one block each.
 *
 * What is interpolated in a cell lies between the samples that clamping to a block's hull leaves of the cell: those of
 * its own block, and, where it reaches beyond the hull of these, those of the blocks beyond, whose outermost samples
 * are blended in.
 *
 * Switches (-D): LANES (1), VOXEL_BITS, VOXEL_SIGNED, VOXEL_SCALED, VOXEL_HOLES, WARPED_CLASSES, INTERBLOCK,
 * SAMPLE_BUFFERS.
 */
#include "lanes.h"
#include "view.h"
#include "block_parameters.h"
#include "classify.h"
#include "features.h"
#include "blocks.h"
#include "block_samples.h"
#include "shows_between.h"

/* What is interpolated in the cell (cx, cy, cz) of a block that is not dropped: the lowest and the highest finite sample,
 * low > high where none is; returns whether any is not finite. */
inline int range_of_cell(const BlockVolume *v, __constant const View *view, const Record *own, int cx, int cy, int cz,
                         float *low, float *high)
{
  const int shift = view->cell_shift, edge = 1 << v->blocks->log_edge, cell = 1 << shift;
  const int4 count = v->blocks->count;
  int holes = 0;
  /* Places in the block; faces of the block that the cell comes nearer than half a sample. */
  const int x = (cx << shift) - own->x * edge, y = (cy << shift) - own->y * edge, z = (cz << shift) - own->z * edge;
  const int sample = edge >> (code_of(own) - 1), far = 2 * (edge - cell);
  const int4 nearest = INTERBLOCK ? -(int4)(2 * x < sample, 2 * y < sample, 2 * z < sample, 0) : 0;
  const int4 farthest = INTERBLOCK ? (int4)(2 * x > far - sample, 2 * y > far - sample, 2 * z > far - sample, 0) : 0;
  *low = INFINITY, *high = -INFINITY;
  for (int dz = nearest.z; dz <= farthest.z; ++dz)
    for (int dy = nearest.y; dy <= farthest.y; ++dy)
      for (int dx = nearest.x; dx <= farthest.x; ++dx) {
        const int nx = own->x + dx, ny = own->y + dy, nz = own->z + dz;
        if (nx < 0 || ny < 0 || nz < 0) continue;
        if (nx >= count.x || ny >= count.y || nz >= count.z) continue;
        const Record r = fetch_record(v, nx, ny, nz);
        const int code = code_of(&r);
        if (code == CODE_DROPPED) {
          widen(as_float(r.word0), low, high);
          continue;
        }
        const int s = 1 << (code - 1);
        const int2 i = samples_between(x - dx * edge, x - dx * edge + cell, s, edge);
        const int2 j = samples_between(y - dy * edge, y - dy * edge + cell, s, edge);
        const int2 k = samples_between(z - dz * edge, z - dz * edge + cell, s, edge);
        for (int c = k.x; c <= k.y; ++c)
          for (int b = j.x; b <= j.y; ++b)
            for (int a = i.x; a <= i.y; ++a) {
              const float sample = own_sample(v, &r, s, a, b, c);
              holes |= !isfinite(sample);
              widen(sample, low, high);
            }
      }
  return holes;
}

inline Record record_of_cell(const BlockVolume *v, __constant const View *view, int cx, int cy, int cz)
{
  const int within = v->blocks->log_edge - view->cell_shift;
  return fetch_record(v, cx >> within, cy >> within, cz >> within);
}

/* before  int [nodes]: of the intervals between nodes, how many before this one can show anything
 * at      uchar [nodes]: whether the node itself does
 * first   the first cell (x, y, z) of the launch
 * cells   uchar [z, y, x]: CELL_VISIBLE where something can be visible, CELL_BESIDE_HOLES where samples that are not
 *         finite lie beside others, else CELL_EMPTY
 */
__kernel void visible_block_cells(__global const uchar *restrict volume, __global const float *restrict warp,
                                  __global const int *restrict before, __global const uchar *restrict at,
                                  __constant const View *restrict view, BLOCK_PARAMETERS, int4 first,
                                  __global uchar *restrict cells)
{
  const BlockVolume held = BLOCK_VOLUME;
  const BlockVolume *v = &held;
  const int cx = get_global_id(0) + first.x, cy = get_global_id(1) + first.y, cz = get_global_id(2) + first.z;
  __global uchar *out = cells + ((size_t)cz * view->cells.y + cy) * view->cells.x + cx;
  *out = CELL_EMPTY;
  const Record own = record_of_cell(v, view, cx, cy, cz);
  if (code_of(&own) == CODE_DROPPED) return;
  float low, high;
  const int holes = range_of_cell(v, view, &own, cx, cy, cz, &low, &high);
  if (shows_between(low, high, warp, before, at, view)) *out = CELL_VISIBLE;
  if (holes && low <= high) *out = CELL_BESIDE_HOLES;
}

/* first   the first cell (x, y, z) of the launch
 * ranges  float2 per cell of the launch, [z, y, x]: the lowest and the highest value that is interpolated there, low >
 *         high where none is finite. A dropped block has its one value.
 */
__kernel void block_cell_ranges(__global const uchar *restrict volume, __constant const View *restrict view,
                                BLOCK_PARAMETERS, int4 first, __global float2 *restrict ranges)
{
  const BlockVolume held = BLOCK_VOLUME;
  const BlockVolume *v = &held;
  const int x = get_global_id(0), y = get_global_id(1), z = get_global_id(2);
  const Record own = record_of_cell(v, view, x + first.x, y + first.y, z + first.z);
  float low = INFINITY, high = -INFINITY;
  if (code_of(&own) == CODE_DROPPED)
    widen(as_float(own.word0), &low, &high);
  else
    range_of_cell(v, view, &own, x + first.x, y + first.y, z + first.z, &low, &high);
  ranges[((size_t)z * get_global_size(1) + y) * get_global_size(0) + x] = (float2)(low, high);
}
