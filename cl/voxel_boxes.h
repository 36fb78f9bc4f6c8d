/* Voxels in plain boxes (clvol/device/voxel_boxes.py): rows are whole, rows and slices begin at `box`.x and `box`.y, and
 * there are `box`.z rows in a slice. A kernel's own rows and slices begin at `begin`.x and `begin`.y. Coordinates are
 * those of the volume, of which `size` is the size.
 */
#ifndef VOXEL_BOXES_H
#define VOXEL_BOXES_H

#include "voxel_type.h"

#define BOX_PARAMETERS __global const Voxel *restrict volume, int4 box, int4 begin
#define BOX_ROW(j, k) (((size_t)((k) - box.y) * box.z + ((j) - box.x)) * size.x)
#define OWN_ROW ((int)get_global_id(0) + begin.x)
#define OWN_SLICE ((int)get_global_id(1) + begin.y)

#endif
