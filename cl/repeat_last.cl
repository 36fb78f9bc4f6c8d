/* Blocks at the volume's upper faces: what decoding gives beyond the volume is replaced by the volume's last samples,
 * which interpolation there uses. A work-item takes one block.
 *
 * ends     int4 per block: element of its first sample; samples along x, y and z that are in the volume
 * samples  Voxel: blocks of size^3
 *
 * Switches (-D): VOXEL_BITS, VOXEL_SIGNED.
 */
#include "voxel_type.h"

__kernel void repeat_last(__global const int4 *restrict ends, int size, __global Voxel *restrict samples)
{
  const int4 end = ends[get_global_id(0)];
  __global Voxel *block = samples + end.x;
  /* Where a sample is taken from is in the volume, and not changed. */
  for (int z = 0; z < size; ++z)
    for (int y = 0; y < size; ++y) {
      __global const Voxel *from = block + (min(z, end.w - 1) * size + min(y, end.z - 1)) * size;
      __global Voxel *to = block + (z * size + y) * size;
      if (to != from)
        for (int x = 0; x < min(end.y, size); ++x) to[x] = from[x];
      for (int x = end.y; x < size; ++x) to[x] = from[end.y - 1];
    }
}
