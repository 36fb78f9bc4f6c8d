/* gradient_at() and the filter's value at lattice points. */
#include "lanes.h"
#include "view.h"
#include "gradient.h"

/* at float [3, n]: x, y, z; out float [4, n]: the gradient's x, y, z, and the value. n is a multiple of LANES. */
__kernel WIDE_VECTORS void gradient_points(__global const uchar *volume, __global const uint *gradients,
                                           __constant const View *view, float4 scale, __global const float *at, int n,
                                           __global float *out)
{
  const size_t k = get_global_id(0) * LANES;
  const floatN x = LOAD_LANES(at + k), y = LOAD_LANES(at + n + k), z = LOAD_LANES(at + 2 * n + k);
  const Gradient g = gradient_at(volume, gradients, view, scale, x, y, z);
  STORE_LANES(g.x, out + k);
  STORE_LANES(g.y, out + n + k);
  STORE_LANES(g.z, out + 2 * n + k);
  STORE_LANES(sample_value(fetch_sample(volume, view, x, y, z), view), out + 3 * n + k);
}
