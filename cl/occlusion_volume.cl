/* Fills the grid of ambient_occlusion.h: rays from each of its points, by the march of shadow.h.
 *
 * Switches (-D): those of the picture.
 */
#define FADES_WITH_DISTANCE 1
#include "light_cells.h"
#include "shadow.h"

/* ways     float4 [directions]: local, of unit length
 * reach    edges; near: edges within which `clear` looks
 * seen     float4 [points]: mean of what arrives, and of that times the direction
 * clear    float [points]: mean transmittance of the nearest part of the rays
 * samples  uint [work-items]: reconstructions of the volume
 * first    point of this launch
 */
__kernel WIDE_VECTORS void occlusion_volume(SCENE_PARAMETERS, __global const float4 *restrict ways, int directions,
                                            float reach, float near, int first, __global float4 *restrict seen,
                                            __global float *restrict clear, __global uint *restrict samples)
{
  const int4 size = effects->occlusion_size;
  const int points = size.x * size.y * size.z, item = get_global_id(0) + first / LANES;
  if (item * LANES >= points) return;
  Tally counted[SCENE_COUNTERS] = {0};
  const Scene scene_ = SCENE;
  const Scene *scene = &scene_;
  const intN point = min(item * LANES + LANE_INDEX, (intN)(points - 1));
  const Vectors place = grid_place(view, size, point);
  const intN all = MASK(item * LANES + LANE_INDEX < points);
  floatN mean = 0.0f, open = 0.0f;
  Vectors way = {0.0f, 0.0f, 0.0f};
  _Pragma("unroll 1") for (int k = 0; k < directions; ++k) {
    const Vectors towards = broadcast3(ways[k]);
    Fading fading = {1.0f, 0.0f, 1.0f, 1.0f / reach, near};
    depth_towards(scene, place, towards, (floatN)reach, all, &fading, counted);
    const floatN arrives = 1.0f - fading.taken;
    mean += arrives, open += fading.left_near;
    way = sum3(way, scaled3(towards, arrives));
  }
  float m[LANES], wx[LANES], wy[LANES], wz[LANES], o[LANES];
  STORE_LANES(mean / (float)directions, m);
  STORE_LANES(way.x / (float)directions, wx);
  STORE_LANES(way.y / (float)directions, wy);
  STORE_LANES(way.z / (float)directions, wz);
  STORE_LANES(open / (float)directions, o);
  EACH_LANE_ROLLED(k)
  {
    const int p = item * LANES + k;
    if (p >= points) continue;
    seen[p] = (float4)(m[k], wx[k], wy[k], wz[k]);
    clear[p] = o[k];
  }
  samples[item] = tally_sum(counted[COUNT_SHADOW_SAMPLES]);
}
