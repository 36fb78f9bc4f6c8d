/* What of a light arrives at given places: light_that_arrives() by itself. */
#include "render_packet.h"

/* places  float [4, n]: lattice x, y, z, and the sample's weight; n a multiple of LANES
 * shares  float [3, n]
 * light   number among all lights */
__kernel void light_at(SCENE_PARAMETERS COUNTS_PARAMETER, __global const float *restrict places, int n,
                       int light, __global float *restrict shares)
{
  DECLARE_TALLIES
  const Scene scene = SCENE;
  const int first = get_global_id(0) * LANES;
  const Vectors place = {LOAD_LANES(places + first), LOAD_LANES(places + n + first), LOAD_LANES(places + 2 * n + first)};
  const floatN weight = LOAD_LANES(places + 3 * n + first);
  const Vectors here = to_local(effects, place.x, place.y, place.z);
  const float4 at = items[effects->first_light + LIGHT_ROWS * light];
  const float4 intensity = items[effects->first_light + LIGHT_ROWS * light + 1];
  Vectors towards = broadcast3(at);
  if (light_has_place(at)) {
    const Vectors way = {at.x - here.x, at.y - here.y, at.z - here.z};
    towards = unit3(way);
  }
  const Vectors share = light_that_arrives(&scene, place, towards, at, (int)intensity.w, weight, (intN)-1, counted);
  STORE_LANES(share.x, shares + first), STORE_LANES(share.y, shares + n + first), STORE_LANES(share.z, shares + 2 * n + first);
  STORE_TALLIES(get_global_id(0))
}
