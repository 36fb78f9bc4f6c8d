/* How far blocks of samples are from others: of each, the sum of the squares of differences over finite samples. A
 * work-item takes one block.
 *
 * a, b     Voxel [count, samples]
 * squares  float [count]
 *
 * Switches (-D): VOXEL_BITS, VOXEL_SIGNED.
 */
#include "voxel_type.h"

__kernel void block_differences(__global const Voxel *restrict a, __global const Voxel *restrict b, int samples,
                                float gain, __global float *restrict squares)
{
  const int block = get_global_id(0);
  const size_t first = (size_t)block * samples;
  float sum = 0.0f;
  for (int row = 0; row < samples; row += 64) {
    float part = 0.0f; /* few summands at a time: none is lost beside a large sum */
    for (int k = row; k < min(row + 64, samples); ++k) {
      const float d = ((float)a[first + k] - (float)b[first + k]) * gain;
      part += isfinite(d) ? d * d : 0.0f;
    }
    sum += part;
  }
  squares[block] = sum;
}
