/* cl/lanes.h alone: what each function makes of given lanes. */
#include "lanes.h"

/* A packet per work-item: v float [n], at int [n] (0 .. 15), bits uint [n / LANES], words uchar [any]; `offsets` int [n],
 * elements of 2 bytes in `words`. `results` uint [RESULTS, n]: a row per function below. */
__kernel void lanes_alone(__global const float *v, __global const int *at, __global const uint *bits,
                          __global const uchar *words, __global const int *offsets, int n, __global uint *results)
{
  const size_t item = get_global_id(0), first = item * LANES;
  const floatN x = LOAD_LANES(v + first);
  const intN to = LOAD_LANES(at + first), offset = LOAD_LANES(offsets + first);
  const uint set = bits[item];
  const intN mask = lanes_of(set);
  float packed[2 * LANES], unpacked[LANES];
  for (int k = 0; k < 2 * LANES; ++k) packed[k] = -1.0f;
  pack_lanes(x, set, packed);
  STORE_LANES(x, unpacked);
  uintN low, high;
  gather_two2(words, offset, &low, &high);
  const uintN rows[] = {
    AS_UINT(LOAD_LANES(packed)), AS_UINT(unpack_lanes(unpacked, set)), AS_UINT(permuted_lanes(x, to)), AS_UINT(permuted_lanes(x, to - 80)),
    AS_UINT(permuted_lanes8(v + first, to & 7)), AS_UINT(gather_private(unpacked, to)), AS_UINT(mask),
    (uintN)lane_bits(mask), (uintN)(uint)any_lane(mask), gather1(words, offset), gather2(words, offset), low, high,
    (uintN)(uint)least_lane(to), AS_UINT(lane_reciprocal(x)), AS_UINT(rough_reciprocal(x)), AS_UINT(lane_rsqrt(x))};
  for (int row = 0; row < (int)(sizeof(rows) / sizeof(uintN)); ++row)
    STORE_LANES(rows[row], results + (size_t)row * n + first);
}
