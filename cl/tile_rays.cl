/* The ray caster for a list of pixels: the switches and the scene are those of raycast.cl, the list is that of tile_rays.h. */
#include "render_packet.h"

#define PACKET_PARAMETERS                                                                                                 \
  __global const uchar *restrict volume, __global const float *restrict table, __global const float *restrict warp,       \
    __global const uchar *restrict distances, __constant const View *restrict view
#define PACKET_ARGUMENTS volume, table, warp, distances, view
#include "tile_rays.h"
