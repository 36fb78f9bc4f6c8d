/* The numbers of one frame: its rays, its picture and the volume. The host fills it (clvol/opencl/structs.py declares
 * the same fields, and a kernel reports these so that the host compares them). What changes from frame to frame is
 * here, not in a switch: moving the camera compiles nothing.
 *
 * Positions are in lattice coordinates: voxel centres at 0 .. size - 1 along x, y, z. (An axis of one voxel is stored
 * twice and runs from 0 to 1.) Lengths t along a ray are in smallest voxel edges, measured from the reference plane:
 * perpendicular to the view, it touches the volume from the front, or contains the eye. So neither a distant eye nor a
 * wide view costs precision.
 */
#ifndef VIEW_H
#define VIEW_H

#include "features.h"
#include "struct_fields.h"

#if VOXEL_BITS == 64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#endif

typedef struct {
  float4 plane_origin; /* x, y, z: lattice point of the image centre on the reference plane */
  float4 plane_du;     /* x, y, z: its change per pixel to the right */
  float4 plane_dv;     /* x, y, z: its change per pixel down */
  float4 ray_forward;  /* x, y, z: lattice units per edge along the ray of the image centre */
  float4 ray_du;       /* x, y, z: change of the direction, not yet normalised, per pixel to the right */
  float4 ray_dv;       /* x, y, z: and down */
  float4 upper;        /* x, y, z: size - 1 */
  float4 shows_above;  /* nothing is visible between two values if of each component both are <= this */
  float4 shows_below;  /* or both >= that */
  float4 opacity_terms, opacity_more; /* opacity of a step through one value (step_opacity() of transfer_pieces.h), */
  float4 filter_terms[MOST_FILTER_TERMS]; /* polynomials of a kernel's weights (kernel_filter.h) */
  float4 level_scales[MOST_VOLUME_LEVELS]; /* x, y, z: voxels of a level per voxel (volume_levels.h) */
  int4 level_sizes[MOST_VOLUME_LEVELS];    /* x, y, z: a level's lattice points; w: elements before its first one */
  float4 footprint;    /* of a pixel at a lattice place: w + (x, y, z) . place, in edges of the levels' voxels */
  int4 size;           /* x, y, z: lattice points */
  int4 cells;          /* x, y, z: cells of the distance map (skip_empty.h) */
  float4 owned_from;   /* x, y, z: with OWNED_BOX (owned_box.h), the box that owns the segments whose front is at or */
  float4 owned_to;     /* beyond the one and before the other */
  int4 stored_from;    /* x, y, z: the first voxel that is on the device, */
  int4 stored_to;      /* and the lower corner of the last cell */
#if VOXEL_BITS == 64
  double voxel_bias_double, voxel_gain_double; /* float64 voxels are read as (v - bias) gain */
#endif
  float2 tangent;       /* of the view angle, per pixel to the right and down */
  float2 centre;        /* of the image, in pixels: column, row */
  float2 footprints;    /* the least and the largest that levels are chosen for, powers of two */
  int2 image;           /* pixels: width, height */
  int2 tile;            /* of a work-item, pixels: width, height */
  int2 lattice;         /* rays that were cast first: columns, rows (fill_between_rays.cl) */
  int ray_spacing;      /* pixels between those rays */
  float ray_tolerance;  /* largest difference of four rays, in any channel, that pixels are interpolated between */
  int first_tile;       /* of this launch */
  float step;           /* edges */
  float plane_distance; /* edges from the eye to the reference plane */
  float stop_opacity;   /* opacity at which a ray ends */
  float deepest;        /* edges from the reference plane to the volume's farthest corner; 0: spans are not looked for
                         * (packet_spans.h) */
  float edge_length;    /* world units per edge */
  float first_value;    /* value of node 0 (shows_between.h) */
  float nodes_per_value;
  float last_node;      /* number of nodes - 1 */
  float warp_bins;
  float gate_low;       /* no value at or below this one is visible, */
  float gate_high;      /* nor any at or above that one */
  float step_units;     /* opacity units per step */
  float opacity_limit;  /* for opacities up to this one */
  float voxel_gain;     /* of scaled float32 voxels */
  float zero;           /* 0, which the compiler does not know (sample_volume.h, SAMPLE_REPEATS) */
  int cell_shift;       /* log2 of a distance map's cell in lattice units */
  int cell_parts;       /* parts that quadrature by cells cuts each cell's piece in */
  int row_stride;       /* elements from one row of voxels to the next */
  int slice_stride;     /* and from one slice to the next */
  int piece_columns;    /* columns of the transfer function's table (transfer_pieces.h) */
  int piece_count;      /* pieces of the function that has most */
  int function_floats;  /* of one function's table */
  int octant_cells;     /* cells of the distance map, where one per octant follows it (skip_empty.h); else 0 */
} View;

#if VOXEL_BITS == 64
#define VIEW_DOUBLES FIELD(View, voxel_bias_double), FIELD(View, voxel_gain_double),
#else
#define VIEW_DOUBLES
#endif

/* Reported to the host (struct_fields.h). */
#define VIEW_FIELDS VIEW_DOUBLES \
  STRUCT(View), FIELD(View, plane_origin), FIELD(View, plane_du), FIELD(View, plane_dv), \
  FIELD(View, ray_forward), FIELD(View, ray_du), FIELD(View, ray_dv), FIELD(View, upper), \
  FIELD(View, shows_above), FIELD(View, shows_below), FIELD(View, opacity_terms), \
  FIELD(View, opacity_more), FIELD(View, filter_terms), FIELD(View, opacity_limit), FIELD(View, size), \
  FIELD(View, level_scales), FIELD(View, level_sizes), FIELD(View, footprint), FIELD(View, footprints), \
  FIELD(View, owned_from), FIELD(View, owned_to), FIELD(View, stored_from), FIELD(View, stored_to), \
  FIELD(View, cells), FIELD(View, tangent), FIELD(View, centre), FIELD(View, image), FIELD(View, tile), \
  FIELD(View, lattice), FIELD(View, ray_spacing), FIELD(View, ray_tolerance), FIELD(View, first_tile), \
  FIELD(View, step), FIELD(View, plane_distance), FIELD(View, stop_opacity), FIELD(View, deepest), \
  FIELD(View, edge_length), \
  FIELD(View, first_value), FIELD(View, nodes_per_value), FIELD(View, last_node), FIELD(View, warp_bins), \
  FIELD(View, gate_low), FIELD(View, gate_high), FIELD(View, step_units), FIELD(View, voxel_gain), \
  FIELD(View, zero), FIELD(View, cell_shift), FIELD(View, cell_parts), FIELD(View, row_stride), \
  FIELD(View, slice_stride), FIELD(View, piece_columns), FIELD(View, piece_count), FIELD(View, function_floats), \
  FIELD(View, octant_cells)

#endif
