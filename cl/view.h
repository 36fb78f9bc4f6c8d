/* What one frame needs, as one struct: the host fills it (clvol/device/view.py holds the same layout as a numpy dtype, and
 * a kernel reports its size so that a test compares the two). Everything that changes from frame to frame is here and
 * nothing of it is a compiler switch: a camera move never compiles.
 *
 * Positions are in lattice coordinates: voxel centres at 0 .. size - 1 along x, y, z (an axis of one voxel is held twice, and
 * runs from 0 to 1). Lengths t along a ray are in smallest voxel edges, measured from the reference plane: perpendicular to
 * the view, it touches the volume from the front, or holds the eye. A far eye or a wide view so costs no precision.
 */
#ifndef VIEW_H
#define VIEW_H

#if VOXEL_BITS == 64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#endif

typedef struct {
  float4 plane_origin;  /* lattice point of the image centre on the reference plane */
  float4 plane_du;      /* its change a pixel to the right */
  float4 plane_dv;      /* its change a pixel down */
  float4 ray_forward;   /* lattice units an edge along the ray of the image centre */
  float4 ray_du;        /* change of the (not yet normalised) direction a pixel to the right */
  float4 ray_dv;        /* and down */
  float4 lens;          /* tangent of the view angle a pixel to the right, down; image centre x, y in pixels */
  float4 march;         /* step h; distance from the eye to the reference plane; opacity at which a ray stops; world length
                         of an edge */
  float4 upper;         /* size - 1 */
  float4 classes;       /* value of class coordinate 0; class coordinates a value; last coordinate; bins of the warp */
  float4 gate;          /* values: nothing at or below x, or at or above y, is visible; a step in opacity units; - */
  float4 voxel;         /* gain of scaled float32 voxels; parts that quadrature by cells cuts each cell's piece in; how far
                         * apart rays may be that pixels are interpolated between; - */
#if VOXEL_BITS == 64
  double2 voxel_double; /* float64 voxels are read as (v - bias) * gain: bias, gain */
#else
  float4 voxel_double;
#endif
  int4 size;            /* lattice points x, y, z; - */
  int4 stride;          /* elements from one row to the next, from one slice to the next; - ; - */
  int4 cells;           /* cells of the distance map x, y, z; log2 of a cell's edge */
  int4 image;           /* width, height; tile width, height in pixels */
  int4 band;            /* first tile of this launch; of a lattice of rays: spacing in pixels, columns, rows */
  int4 table;           /* class nodes; entries of a table by them; - ; - */
  int4 pieces;          /* of the transfer function: columns of its table; - ; floats of a function; pieces */
} View;

#endif
