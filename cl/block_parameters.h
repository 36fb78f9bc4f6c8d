/* What kernels need of a volume that is stored as blocks (BLOCKS), beside the first buffer of samples, which is in the
 * place of the volume:
 *
 * index    int2 per block, in C order of (z, y, x), see blocks.h
 * corners  a word per corner of the block lattice: the codes of the eight blocks around it, see blend_blocks.h
 * blocks   sizes
 * samples1 ... samples3   further buffers of samples, where one is too small (SAMPLE_BUFFERS)
 * steps    a byte per block: the most steps that a ray may take at once in it (STEPPING bounded)
 * counts   uint [tiles, BLOCK_COUNTERS], written at a kernel's end
 */
#ifndef BLOCK_PARAMETERS_H
#define BLOCK_PARAMETERS_H

#include "features.h"
#include "lanes.h"
#include "struct_fields.h"
#include "view.h"

typedef struct {
  int4 count;         /* x, y, z: blocks */
  float edge;         /* of a block, voxels */
  float inverse_edge;
  int log_edge;       /* log2 of it */
} Blocks;

/* Reported to the host (struct_fields.h). */
#define BLOCKS_FIELDS  \
  STRUCT(Blocks), FIELD(Blocks, count), FIELD(Blocks, edge), FIELD(Blocks, inverse_edge), \
  FIELD(Blocks, log_edge)

/* values interpolated inside a block: one per sample, and one for each further block that is blended in */
#define COUNT_BLOCK_READS 0
#define COUNT_BLENDED_SAMPLES 1     /* samples that more than one block has a share in */
#define BLOCK_COUNTERS 2

typedef struct {
  __global const int *index;
  __global const uint *corners;
  __constant const Blocks *blocks;
  __constant const View *view;
  __global const uchar *samples[SAMPLE_BUFFERS];
  __global const uchar *steps; /* only set where STEPPING is bounded */
} BlockVolume;

#if SAMPLE_BUFFERS == 1
#define MORE_SAMPLE_PARAMETERS
#define BLOCK_SAMPLES {volume}
#elif SAMPLE_BUFFERS == 2
#define MORE_SAMPLE_PARAMETERS , __global const uchar *restrict samples1
#define BLOCK_SAMPLES {volume, samples1}
#elif SAMPLE_BUFFERS == 3
#define MORE_SAMPLE_PARAMETERS , __global const uchar *restrict samples1, __global const uchar *restrict samples2
#define BLOCK_SAMPLES {volume, samples1, samples2}
#elif SAMPLE_BUFFERS == 4
#define MORE_SAMPLE_PARAMETERS \
  , __global const uchar *restrict samples1, __global const uchar *restrict samples2, \
      __global const uchar *restrict samples3
#define BLOCK_SAMPLES {volume, samples1, samples2, samples3}
#else
#error "SAMPLE_BUFFERS must be 1 to 4"
#endif

#if STEPPING == STEPPING_BOUNDED
#define STEP_PARAMETER , __global const uchar *restrict steps
#define BLOCK_STEPS steps
#else
#define STEP_PARAMETER
#define BLOCK_STEPS 0
#endif

/* The parameters of a kernel beside `volume` and `view`, and the BlockVolume of all of them as an initialiser. */
#define BLOCK_PARAMETERS                                                                                              \
  __global const int *restrict index, __global const uint *restrict corners, __constant const Blocks *restrict blocks \
    MORE_SAMPLE_PARAMETERS STEP_PARAMETER
#define BLOCK_VOLUME {index, corners, blocks, view, BLOCK_SAMPLES, BLOCK_STEPS}

#endif
