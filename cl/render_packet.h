/* The march of this program: the switches choose one of them. Each defines
 *
 *   void render_packet(const Scene *scene, intN px, intN py, Span span, float *rgba, float *depth, uint *samples,
 *                      Tally *counted)
 *
 * for the rays through the pixels (px, py), a packet of LANES; a lane outside the picture has no ray.
 * span     between which depths anything can be visible (packet_spans.h); rays may look beyond it
 * rgba     float [LANES, 4]: premultiplied, linear
 * depth    float [LANES]: world distance along the ray from the eye to where opacity reaches one half, else infinity;
 *          written only where WITH_DEPTH is set
 * samples  uint [LANES]: reconstructions of the volume
 * counted  SCENE_COUNTERS tallies (scene.h)
 *
 * To add one: a file march_NAME.h with this function, which includes march.h; a switch for it below, and in
 * raycast_switches() of clvol/integrators/raycast.
 */
#ifndef RENDER_PACKET_H
#define RENDER_PACKET_H

#include "features.h"
#include "lanes.h"
#include "scene.h"

/* march_shaded.h in place of march_effects.h, where that is possible and lanes are packed in few instructions. */
#ifndef HOLD_SEGMENTS
#ifdef NATIVE_LANES
#define HOLD_SEGMENTS 1
#else
#define HOLD_SEGMENTS 0
#endif
#endif

#define SHADED_MARCH \
  (EFFECTS && !COMPOSITING && HOLD_SEGMENTS && SEGMENT_OPACITIES && TRANSLUCENT && !NOISE && !SLICES && !OWNED_BOX && \
   !MINIFICATION)

#if BLOCKS && !EFFECTS
#include "march_blocks.h"
#elif EFFECTS && COMPOSITING
#include "project.h"
#elif EFFECTS && SLICES
#include "march_half_angle.h"
#elif SHADED_MARCH
#include "march_shaded.h"
#elif EFFECTS
#include "march_effects.h"
#elif SLICES
#include "march_slices.h"
#elif STEP_CELLS
#include "march_steps.h"
#elif QUADRATURE == QUADRATURE_CELLS
#include "march_cells.h"
#else
#include "march_plain.h"
#endif

#endif
