/* Unpacks blocks from a staging buffer into the packed buffers that rays sample (a work-item takes one slice of one
 * block), and brings their index up to date.
 *
 * What is staged is what was stored, each block by its codec (BlockPayload.codec):
 *   CODEC_RAW       all samples [s, s, s], of the volume's type
 *   CODEC_CONSTANT  one sample, which fills the block
 * Any other codec is an error, which is reported; its block is zeros. (Codes of vector quantisation: decode_codes.cl.)
 * Samples are of the volume's own type here and there, but for float64: those are brought into float's range as
 * (v - bias) * gain and held as float32 (clvol/device/memory.py, ValueMap), so that no ray computes in double.
 *
 * Where this departs from Ljung 2006, section 3.2: there the CPU unpacks blocks and the GPU holds them as they are
 * used; here only what is stored crosses the bus.
 *
 * Switches (-D): VOXEL_BITS, VOXEL_SIGNED of the samples that are held; STAGED_DOUBLE where float64 is staged.
 */
#include "features.h"
#include "struct_fields.h"
#include "voxel_type.h"

#if STAGED_DOUBLE
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double Staged;
#define HELD(v) ((Voxel)(((v) - bias) * gain))
#else
typedef Voxel Staged;
#define HELD(v) (v)
#endif


/* from: where in `staged` it begins; to: place of the first sample in `samples`; size: samples per axis; codec as
 * above. */
typedef struct {
  int from, to, size, codec;
} BlockPayload;

/* Reported to the host (struct_fields.h). */
#define BLOCK_PAYLOAD_FIELDS \
  STRUCT(BlockPayload), FIELD(BlockPayload, from), FIELD(BlockPayload, to), FIELD(BlockPayload, size), \
      FIELD(BlockPayload, codec)

/* One axis of work-items goes over the payloads, at least `count` of them, the other along z of a block (the largest
 * there is).
 *
 * payloads  BlockPayload [count]
 * staged    Staged: what all payloads refer to
 * samples   Voxel: one of the sample buffers
 * fault     int: a codec that is not known, where there was one
 */
__kernel void decode_blocks(__global const BlockPayload *restrict payloads, int count,
                            __global const Staged *restrict staged,
#if STAGED_DOUBLE
                            double bias, double gain,
#endif
                            __global Voxel *restrict samples, __global int *restrict fault)
{
  if (get_global_id(0) >= count) return;
  const BlockPayload p = payloads[get_global_id(0)];
  const int z = get_global_id(1), slice = p.size * p.size;
  if (z >= p.size) return;
  __global Voxel *out = samples + (size_t)p.to + z * slice;
  __global const Staged *in = staged + p.from;
  if (p.codec == CODEC_CONSTANT) {
    const Voxel v = HELD(in[0]);
    for (int k = 0; k < slice; ++k) out[k] = v;
  } else if (p.codec == CODEC_RAW) {
    in += z * slice;
    for (int k = 0; k < slice; ++k) out[k] = HELD(in[k]);
  } else {
    for (int k = 0; k < slice; ++k) out[k] = 0;
    *fault = p.codec;
  }
}

/* Index and corners where little of them changes: changes int2 [count] (place, word), words what they are put into. */
__kernel void put_words(__global const int2 *restrict changes, int count, __global int *restrict words)
{
  if (get_global_id(0) >= count) return;
  const int2 change = changes[get_global_id(0)];
  words[change.x] = change.y;
}
