/* The address arithmetic of fetch_voxel.h alone: no voxel is read. */
#include "lanes.h"
#include "view.h"
#include "fetch_voxel.h"

/* Of the cells (x, y, z) [n]: offsets in elements; bytes: from the first voxel to the first byte of the farthest corner. */
__kernel void corner_offsets(__constant const View *view, __global const int *x, __global const int *y, __global const int *z,
                             __global int *offsets, __global ulong *bytes)
{
  const size_t first = get_global_id(0) * LANES;
  const intN at = corner_offset(0, view, LOAD_LANES(x + first), LOAD_LANES(y + first), LOAD_LANES(z + first));
  int each[LANES];
  STORE_LANES(at, each);
  EACH_LANE(k)
  {
    offsets[first + k] = each[k];
    bytes[first + k] = (ulong)slice_bytes(view) + row_bytes(view) + (ulong)each[k] * ELEMENT_BYTES + VOXEL_BITS / 8;
  }
}
