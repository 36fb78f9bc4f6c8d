/* cl/noise.h alone: the sums of every channel, and what terms do to places and values. */
#include "lanes.h"
#include "noise.h"

/* sums [4, n]: x, y, z, value of terms[0] at place (x, y, z) [n] in tiles. */
__kernel void noise_sums(__global const uint *tiles, __constant const NoiseTerm *terms, __global const float *x,
                         __global const float *y, __global const float *z, __global float *sums, int n)
{
  const size_t first = get_global_id(0) * LANES;
  const floatN px = LOAD_LANES(x + first), py = LOAD_LANES(y + first), pz = LOAD_LANES(z + first);
  floatN sx, sy, sz;
  fractal_noise(tiles, terms, px, py, pz, &sx, &sy, &sz);
  float each[LANES];
  STORE_LANES(sx, each);
  EACH_LANE(k) sums[first + k] = each[k];
  STORE_LANES(sy, each);
  EACH_LANE(k) sums[n + first + k] = each[k];
  STORE_LANES(sz, each);
  EACH_LANE(k) sums[2 * n + first + k] = each[k];
  STORE_LANES(fractal_noise_value(tiles, terms, px, py, pz), each);
  EACH_LANE(k) sums[3 * n + first + k] = each[k];
}

/* done [4, n]: the lattice places (x, y, z) [n] as moved, and what is added to their values. */
__kernel void perturb(__global const uint *tiles, __constant const NoiseTerm *terms, __global const float *x,
                      __global const float *y, __global const float *z, __global float *done, int n, int values,
                      int coordinates)
{
  const size_t first = get_global_id(0) * LANES;
  floatN px = LOAD_LANES(x + first), py = LOAD_LANES(y + first), pz = LOAD_LANES(z + first);
  const floatN added = added_noise(tiles, terms, values, px, py, pz);
  displace(tiles, terms + values, coordinates, &px, &py, &pz);
  float each[LANES];
  STORE_LANES(px, each);
  EACH_LANE(k) done[first + k] = each[k];
  STORE_LANES(py, each);
  EACH_LANE(k) done[n + first + k] = each[k];
  STORE_LANES(pz, each);
  EACH_LANE(k) done[2 * n + first + k] = each[k];
  STORE_LANES(added, each);
  EACH_LANE(k) done[3 * n + first + k] = each[k];
}
