/* One stage of vector quantisation for many sub-blocks: the nearest codeword of each, what is left, and how far decoded
 * voxels are off. Training works with it, and codecs whose sub-blocks all have the same stages.
 *
 * Switches: see nearest_code.h.
 */
#include "nearest_code.h"

/* A work-item takes `each` sub-blocks, a multiple of four, of `count`.
 *
 * work      ushort [count][SIZE], working values
 * residual  int [count][SIZE], what the stages before have left; minus this stage's codeword if `subtracted`
 * codebook, norms  of the stage, see search_codebook
 * entries   char [ENTRIES][SIZE], the codewords
 * codes     uchar [count]
 * squares   ulong [count]; largest  int [count]: how far decoded voxels are off, if `subtracted`
 */
__kernel void encode_stage(__global const ushort *restrict work, __global int *restrict residual,
                           __global const float *restrict codebook, __global const float *restrict norms,
                           __global const char *restrict entries, int shift, int count, int each, int subtracted,
                           uint levels, __global uchar *restrict codes, __global ulong *restrict squares,
                           __global int *restrict largest)
{
  const int end = min(count, (int)(get_global_id(0) + 1) * each);
  float rows[4 * SIZE];
  for (int at = get_global_id(0) * each; at < end; at += 4) {
    for (int v = 0; v < 4; v++)
      as_compared(residual + (size_t)min(at + v, count - 1) * SIZE, shift, rows + v * SIZE);
    int16 keys[4];
    search_codebook(rows, codebook, norms, keys);
    for (int v = 0; v < 4 && at + v < end; v++) {
      const int code = take_nearest(keys + v);
      codes[at + v] = (uchar)code;
      if (!subtracted) continue;
      subtract(residual + (size_t)(at + v) * SIZE, entries + code * SIZE, shift);
      const Miss miss = measure(work + (size_t)(at + v) * SIZE, residual + (size_t)(at + v) * SIZE, levels);
      squares[at + v] = miss.squares;
      largest[at + v] = max(miss.highest, -miss.lowest);
    }
  }
}
