/* Surfaces of the nearest filter: the value is a voxel's own as far as half way to the next one, and jumps there. A
 * "cell" is what is nearest to one voxel, and has the surfaces that the value jumps over where the ray enters it. */
#ifndef CELL_STEP_H
#define CELL_STEP_H

#include "lanes.h"
#include "sample_volume.h"
#include "scene.h"
#include "surface_levels.h"

typedef FetchedSample CellVoxels;

INLINE CellVoxels fetch_cell(__global const uchar *volume, __constant const View *view, intN ix, intN iy, intN iz)
{
  return fetch_nearest(volume, view, TO_FLOAT(ix), TO_FLOAT(iy), TO_FLOAT(iz));
}

/* `before`: the value of the voxel before; lanes in `open` have one. Next to what is not finite there is no surface. */
INLINE CellHit look_in_cell(const Scene *scene, floatN before, floatN value, intN rank, intN open)
{
  CellHit hit = no_hit();
  Bracket bracket = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
  const floatN zero = 0.0f;
  find_between(scene, (intN)0, zero, zero, before, value, rank, open & finite_lanes(before) & finite_lanes(value),
               &hit, &bracket);
  return hit;
}

#endif
