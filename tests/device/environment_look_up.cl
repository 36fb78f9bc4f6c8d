/* The look-up of cl/environment.h alone, a packet a work-item. */
#include "lanes.h"
#include "environment.h"

/* Of directions (x, y, z) [n]: radiance [3, n] of the map of size x size nodes at offset. */
__kernel WIDE_VECTORS void look_up(__global const float4 *map, const int offset, const int size, const int n,
                                   __global const float *x, __global const float *y, __global const float *z,
                                   __global float *radiance)
{
  const size_t first = get_global_id(0) * LANES;
  floatN r, g, b;
  environment_look_up(map + offset, size, LOAD_LANES(x + first), LOAD_LANES(y + first), LOAD_LANES(z + first), &r, &g, &b);
  STORE_LANES(r, radiance + first);
  STORE_LANES(g, radiance + n + first);
  STORE_LANES(b, radiance + 2 * n + first);
}
