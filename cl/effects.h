/* What the effects of a scene need beside the view: numbers in one struct (clvol/opencl/structs.py holds the same
 * layout), lists (lights, surfaces, clips) in `items`, and what has an array of its own. Compiled only where EFFECTS
 * is set: a plain scene's kernels have none of it.
 *
 * "Local" space: the world's axes, origin in the middle of the volume, smallest voxel edges as the unit.
 */
#ifndef EFFECTS_H
#define EFFECTS_H

#include "lanes.h"
#include "view.h"
#include "features.h"
#include "noise.h"
#include "vectors.h"

/* A further volume (fields.h). */
typedef struct {
  float4 x, y, z;      /* lattice point of the volume to the field's: rows of the matrix, with the shift in w */
  float4 lower, upper; /* x, y, z: where the field's domain ends, in its lattice points */
  int4 size;           /* x, y, z: lattice points */
  int role;            /* FIELD_... */
  int first_voxel;     /* in `fields` */
  int table;           /* where its table begins in `factors` */
  int piece_columns;   /* of a density's function: columns of its table, */
  int piece_count;     /* its pieces, */
  int has_pole;        /* whether its opacity reaches 1 in a slope, */
  float edge_units;    /* and opacity units per edge */
  float threshold;     /* of a mask: the value of its border, */
  float side;          /* 1 where larger values are kept, -1 where smaller ones are */
} Field;

typedef struct {
  float4 local_x, local_y, local_z;          /* lattice point to local: rows of the matrix, with the shift in w */
  /* derivative per lattice unit to derivative per edge along the local axes: rows */
  float4 gradient_x, gradient_y, gradient_z;
  float4 gradient_scale;                     /* of precomputed gradients (gradient.h) */
  float4 cue_color;                          /* of depth cueing: r, g, b */
  float4 light_grid;                         /* x, y, z: points of the light volume per lattice unit */
  float4 occlusion_grid;                     /* x, y, z: points of ambient occlusion per lattice unit; its intensity */
  float4 noise_reach;                        /* x, y, z: half an edge, in lattice units */
  int4 light_size;                           /* x, y, z: points of the light volume */
  int4 occlusion_size;                       /* x, y, z: points of the ambient occlusion */
  Field fields[MOST_FIELDS];
  NoiseTerm noise_terms[MOST_NOISE_TERMS];   /* in the order of NOISE_TARGET_... */
  int along_axes;         /* whether the lattice is along the local axes */
  float ambient, diffuse, specular, shininess;
  float fade;             /* 1 / the magnitude per edge below which shading fades; 0: it does not */
  int two_sided;          /* whether surfaces are lit from behind, too */
  float cue_start;        /* of depth cueing: edges from the eye to where it begins, */
  float cue_per_edge;     /* 1 / the edges over which it grows, */
  float cue_strength;     /* and what it grows to, 0 .. 1 */
  float lowest_value;     /* of the volume, for projections */
  float values_per_range; /* 1 / the range of its values */
  float attenuation;      /* per step */
  float hidden_score;     /* score up to which a projection shows nothing */
  float lowest_sample, highest_sample; /* bounds of every sample */
  float shadow_bound;     /* shadow rays are cast for samples that count for more than this */
  float shadow_step;      /* edges */
  float shadow_depth;     /* optical depth beyond which no light arrives */
  float scattering;       /* share of the light that is scattered, 0 .. 1 */
  int light_count, surface_count, kept_clips, removed_clips, mesh_clips;
  int first_light, first_surface, first_clip;                  /* in `items` */
  int diffuse_map_size, specular_map_size, sky_map_size;       /* nodes per side of the maps of the environment, */
  int diffuse_map, specular_map, sky_map;                      /* and where they begin in `environment` */
  int gradient_opacity_points, directional_opacity_points;     /* of opacity factors */
  int layer_count, layer_rows; /* of a function of two values: its layers; of a joint one of three: layers of a row, rows */
  int gradient_opacity_table, directional_opacity_table, layer_table; /* where these begin in `factors` */
  int field_count, added_terms, moving_terms, tinting_terms, fur_terms;
  int glow_points, glow_table; /* of associated colours (glow.h); where they begin in `factors` */
  int index_points, index_table; /* of an index of refraction (curved_rays.h), likewise */
  float longest_path;            /* edges after which rays turn no more */
} Effects;

/* Reported to the host (struct_fields.h). */
#define FIELD_FIELDS  \
  STRUCT(Field), FIELD(Field, x), FIELD(Field, y), FIELD(Field, z), FIELD(Field, lower), FIELD(Field, upper), \
  FIELD(Field, size), FIELD(Field, role), \
  FIELD(Field, first_voxel), FIELD(Field, table), FIELD(Field, piece_columns), FIELD(Field, piece_count), \
  FIELD(Field, has_pole), FIELD(Field, edge_units), FIELD(Field, threshold), FIELD(Field, side)
#define EFFECTS_FIELDS NOISE_TERM_FIELDS, FIELD_FIELDS, \
  STRUCT(Effects), FIELD(Effects, local_x), FIELD(Effects, local_y), FIELD(Effects, local_z), \
  FIELD(Effects, gradient_x), FIELD(Effects, gradient_y), FIELD(Effects, gradient_z), \
  FIELD(Effects, gradient_scale), FIELD(Effects, cue_color), FIELD(Effects, light_grid), \
  FIELD(Effects, occlusion_grid), FIELD(Effects, noise_reach), FIELD(Effects, light_size), \
  FIELD(Effects, occlusion_size), FIELD(Effects, fields), FIELD(Effects, noise_terms), \
  FIELD(Effects, along_axes), FIELD(Effects, ambient), FIELD(Effects, diffuse), FIELD(Effects, specular), \
  FIELD(Effects, shininess), FIELD(Effects, fade), FIELD(Effects, two_sided), FIELD(Effects, cue_start), \
  FIELD(Effects, cue_per_edge), FIELD(Effects, cue_strength), FIELD(Effects, lowest_value), \
  FIELD(Effects, values_per_range), FIELD(Effects, attenuation), FIELD(Effects, hidden_score), \
  FIELD(Effects, lowest_sample), FIELD(Effects, highest_sample), FIELD(Effects, shadow_bound), \
  FIELD(Effects, shadow_step), FIELD(Effects, shadow_depth), FIELD(Effects, scattering), \
  FIELD(Effects, light_count), FIELD(Effects, surface_count), FIELD(Effects, kept_clips), \
  FIELD(Effects, removed_clips), FIELD(Effects, mesh_clips), FIELD(Effects, first_light), FIELD(Effects, first_surface), \
  FIELD(Effects, first_clip), FIELD(Effects, diffuse_map_size), FIELD(Effects, specular_map_size), \
  FIELD(Effects, sky_map_size), FIELD(Effects, diffuse_map), FIELD(Effects, specular_map), \
  FIELD(Effects, sky_map), FIELD(Effects, gradient_opacity_points), FIELD(Effects, directional_opacity_points), \
  FIELD(Effects, layer_count), FIELD(Effects, layer_rows), FIELD(Effects, gradient_opacity_table), FIELD(Effects, directional_opacity_table), \
  FIELD(Effects, layer_table), FIELD(Effects, field_count), FIELD(Effects, added_terms), \
  FIELD(Effects, moving_terms), FIELD(Effects, tinting_terms), FIELD(Effects, fur_terms), \
  FIELD(Effects, glow_points), FIELD(Effects, glow_table), \
  FIELD(Effects, index_points), FIELD(Effects, index_table), FIELD(Effects, longest_path)

/* What is counted beside samples: one number each a tile. clvol/features/vocabulary.py names them in this order. */
#define COUNT_GRADIENTS 0        /* gradients reconstructed */
#define COUNT_LIT_SAMPLES 1              /* samples lit */
#define COUNT_SURFACE_TESTS 2    /* cells tested for surfaces */
#define COUNT_SURFACE_HITS 3     /* surfaces met */
#define COUNT_SHADOW_RAYS 4
#define COUNT_SHADOW_SAMPLES 5   /* reconstructions on shadow rays; not among `samples` */
#define COUNT_FIELD_SAMPLES 6    /* of further fields */
#define COUNT_BENDS 7            /* rays refracted or reflected */
#define EFFECT_COUNTERS 8

/* Items of a light (shade.h): more where lights are aimed (aimed_lights.h); and whether it shines from a place, by the
 * first of them. */
#if AIMED_LIGHTS
#define LIGHT_ROWS 6
INLINE int light_has_place(float4 light) { return light.w == LIGHT_POINT || light.w >= LIGHT_SPOT; }
#else
#define LIGHT_ROWS 2
INLINE int light_has_place(float4 light) { return light.w == LIGHT_POINT; }
#endif

/* Floats per point of a light volume. */
#define LIGHT_CHANNELS (SCATTERING ? 4 : 1)

INLINE Vectors to_local(__constant const Effects *e, floatN x, floatN y, floatN z)
{
  const Vectors r = {e->local_x.x * x + e->local_x.y * y + e->local_x.z * z + e->local_x.w,
                     e->local_y.x * x + e->local_y.y * y + e->local_y.z * z + e->local_y.w,
                     e->local_z.x * x + e->local_z.y * y + e->local_z.z * z + e->local_z.w};
  return r;
}
/* The same for directions. */
INLINE Vectors direction_to_local(__constant const Effects *e, floatN x, floatN y, floatN z)
{
  const Vectors r = {e->local_x.x * x + e->local_x.y * y + e->local_x.z * z,
                     e->local_y.x * x + e->local_y.y * y + e->local_y.z * z,
                     e->local_z.x * x + e->local_z.y * y + e->local_z.z * z};
  return r;
}
/* From a derivative per lattice unit to one per edge along the local axes. */
INLINE Vectors gradient_to_local(__constant const Effects *e, floatN x, floatN y, floatN z)
{
  if (e->along_axes) { /* the lattice is along the axes */
    const Vectors along = {e->gradient_x.x * x, e->gradient_y.y * y, e->gradient_z.z * z};
    return along;
  }
  const Vectors r = {e->gradient_x.x * x + e->gradient_x.y * y + e->gradient_x.z * z,
                     e->gradient_y.x * x + e->gradient_y.y * y + e->gradient_y.z * z,
                     e->gradient_z.x * x + e->gradient_z.y * y + e->gradient_z.z * z};
  return r;
}
/* A local direction of unit length in lattice units per edge. What is parallel to an axis' faces but for rounding is
 * made so: a ray along a face would leave through it. */
INLINE Vectors direction_to_lattice(__constant const Effects *e, Vectors d)
{
  Vectors r = {e->gradient_x.x * d.x + e->gradient_y.x * d.y + e->gradient_z.x * d.z,
               e->gradient_x.y * d.x + e->gradient_y.y * d.y + e->gradient_z.y * d.z,
               e->gradient_x.z * d.x + e->gradient_y.z * d.y + e->gradient_z.z * d.z};
  const floatN still = 1e-7f * lane_max(lane_max(fabs(r.x), fabs(r.y)), fabs(r.z)), zero = 0.0f;
  r.x = select(r.x, zero, MASK(fabs(r.x) < still));
  r.y = select(r.y, zero, MASK(fabs(r.y) < still));
  r.z = select(r.z, zero, MASK(fabs(r.z) < still));
  return r;
}

#endif
