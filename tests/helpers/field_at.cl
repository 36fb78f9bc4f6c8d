/* The value and the gradient at places of a scene. */
#include "render_packet.h"

/* places  float [3, n] (x, y, z), lattice; found  float [4, n]: value, then the gradient per edge along local axes */
__kernel WIDE_VECTORS void field_at(SCENE_PARAMETERS, __global const float *restrict places,
                                    __global float *restrict found)
{
  const Scene scene_ = SCENE;
  const Scene *scene = &scene_;
  const int item = get_global_id(0), n = get_global_size(0) * LANES;
  const floatN x = LOAD_LANES(places + item * LANES), y = LOAD_LANES(places + n + item * LANES);
  const floatN z = LOAD_LANES(places + 2 * n + item * LANES);
  const Vectors g = scene_gradient(scene, x, y, z);
  float v[LANES], gx[LANES], gy[LANES], gz[LANES];
  STORE_LANES(scene_value(scene, x, y, z), v);
  STORE_LANES(g.x, gx);
  STORE_LANES(g.y, gy);
  STORE_LANES(g.z, gz);
  EACH_LANE_ROLLED(k)
  {
    const int at = item * LANES + k;
    found[at] = v[k], found[n + at] = gx[k], found[2 * n + at] = gy[k], found[3 * n + at] = gz[k];
  }
}
