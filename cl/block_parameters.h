/* What kernels need of a volume held as blocks (BLOCKS), beside the first buffer of samples, which stands in the place of the volume:
 *
 * index    int2 a block, in C order of (z, y, x), see blocks.h
 * corners  a word a corner of the block lattice: the codes of the eight blocks around it, see blend_blocks.h
 * blocks   sizes
 * samples1 ... samples3   further buffers of samples, where one is too small (SAMPLE_BUFFERS)
 * steps    a byte a block: the most steps that a ray may take at once in it (STEPPING bounded)
 * counts   uint [tiles, BLOCK_COUNTERS], written at a kernel's end
 */
#ifndef BLOCK_PARAMETERS_H
#define BLOCK_PARAMETERS_H

#include "tally.h"

typedef struct {
  int4 count;  /* blocks x, y, z; log2 of a block's edge in voxels */
  float4 edge; /* voxels, and its inverse; - ; - */
} Blocks;

#define COUNT_BLOCK_READS 0 /* values interpolated inside a block: one a sample, and one for each further block that is blended in */
#define COUNT_BLENDED 1     /* samples that more than one block has a share in */
#define BLOCK_COUNTERS 2

#if SAMPLE_BUFFERS == 1
#define MORE_SAMPLE_PARAMETERS
#define MORE_SAMPLE_ARGUMENTS
#elif SAMPLE_BUFFERS == 2
#define MORE_SAMPLE_PARAMETERS , __global const uchar *restrict samples1
#define MORE_SAMPLE_ARGUMENTS , samples1
#elif SAMPLE_BUFFERS == 3
#define MORE_SAMPLE_PARAMETERS , __global const uchar *restrict samples1, __global const uchar *restrict samples2
#define MORE_SAMPLE_ARGUMENTS , samples1, samples2
#elif SAMPLE_BUFFERS == 4
#define MORE_SAMPLE_PARAMETERS \
  , __global const uchar *restrict samples1, __global const uchar *restrict samples2, __global const uchar *restrict samples3
#define MORE_SAMPLE_ARGUMENTS , samples1, samples2, samples3
#else
#error "SAMPLE_BUFFERS must be 1 to 4"
#endif

#if STEPPING == 3 /* STEPPING_BOUNDED */
#define STEP_PARAMETERS , __global const uchar *restrict steps
#define STEP_ARGUMENTS , steps
#else
#define STEP_PARAMETERS
#define STEP_ARGUMENTS
#endif

#define EFFECT_PARAMETERS                                                                                               \
  , __global const int *restrict index, __global const uint *restrict corners, __constant const Blocks *restrict blocks \
    MORE_SAMPLE_PARAMETERS STEP_PARAMETERS, __global uint *restrict counts
#define EFFECT_PACKET_PARAMETERS                                                                                 \
  , __global const int *index, __global const uint *corners, __constant const Blocks *blocks MORE_SAMPLE_PARAMETERS STEP_PARAMETERS, \
    Tally *counted
#define EFFECT_ARGUMENTS , index, corners, blocks MORE_SAMPLE_ARGUMENTS STEP_ARGUMENTS, counted
#define EFFECT_TALLY Tally counted[BLOCK_COUNTERS] = {0};
#define EFFECT_STORE_TALLY(tile)                                                                \
  for (int counter_ = 0; counter_ < BLOCK_COUNTERS; ++counter_)                                 \
    counts[(size_t)(tile) * BLOCK_COUNTERS + counter_] = tally_sum(counted[counter_]);

#endif
