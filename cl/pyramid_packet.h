/* What the march of the picture's pixels keeps of a packet of them between chunks of slices (pyramid_pixels.h). */
#ifndef PYRAMID_PACKET_H
#define PYRAMID_PACKET_H

#include "half_opacity.h"
#include "lanes.h"
#include "pyramid.h"
#if EFFECTS && ISOSURFACES
#include "surface_walk.h"
#endif

typedef struct PixelPacket {
  float x0[LANES], y0[LANES], z0[LANES], dx[LANES], dy[LANES], dz[LANES]; /* rays by slices */
  float enter[LANES], leave[LANES];
  float distance[LANES];                                                  /* wanted when it was last looked */
  /* the last sample and the one before, and their slices */
  float value1[LANES], value2[LANES], t1[LANES], t2[LANES];
  int first[LANES], second[LANES];                                        /* no sample yet, or only one */
  int alive[LANES];
  float rgba[4 * LANES], opacity[LANES];
#if HELD_LIGHT
  float r[LANES], g[LANES], b[LANES]; /* in place of `rgba` until the end: colours come out of a queue */
#endif
#if CUT_FACES
  int cut[LANES];                                                         /* by which half-space a ray enters, or -1 */
#endif
#if EFFECTS && ISOSURFACES
  SurfaceWalk walk; /* from where the ray enters on */
#endif
#if WITH_DEPTH
  HalfOpacity half_; /* in slices */
#endif
} PixelPacket;

#endif
