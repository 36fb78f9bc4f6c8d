/* A volume as blocks, each at its own resolution (Ljung 2006, sections 3.1 and 3.2), packed in buffers of samples.
 *
 * Places are in voxels, p = lattice coordinate + 1/2: block b holds p from edge * b to edge * (b + 1) along each axis,
 * and a block of s samples per axis has them at its multiples of edge / s, plus a half. Inside a block, values are
 * interpolated linearly between its own samples, the place clamped to their hull (Ljung 2006, eq. 3: C[delta, 1 -
 * delta], delta = 1 / 2 s); blend_blocks.h joins blocks.
 *
 * A block's two words in `index`: word 1 has in bits 0..3 its code, 1 + log2(s), or CODE_DROPPED for a block that
 * shows nothing and has no samples; in bits 4..5 the number of its buffer. Word 0 is the place of its first sample in
 * the buffer. For a block of one sample, and for a dropped one, it is that one value (bits of a float): neither takes
 * memory in the buffers.
 */
#ifndef BLOCKS_H
#define BLOCKS_H

#include "block_parameters.h"
#include "features.h"
#include "lanes.h"
#include "sample_volume.h"
#include "view.h"

#if FILTER != FILTER_LINEAR || VOXEL_BITS == 64 || VOXEL_PAIRS
#error "blocks need the linear filter, and samples of at most 32 bits"
#endif

typedef struct {
  intN x, y, z;      /* block */
  uintN word0, word1;
} Record;

INLINE intN code_of(const Record *r) { return AS_INT(r->word1 & 15u); }

INLINE Record fetch_record(const BlockVolume *v, intN x, intN y, intN z)
{
  Record r;
  r.x = x, r.y = y, r.z = z;
  gather_two4(v->index, 2 * ((z * v->blocks->count.y + y) * v->blocks->count.x + x), &r.word0, &r.word1);
  return r;
}

INLINE intN block_of(floatN p, const BlockVolume *v, int count)
{
  return min(TO_INT(p * v->blocks->inverse_edge), (intN)(count - 1));
}

INLINE Record record_at(const BlockVolume *v, floatN px, floatN py, floatN pz)
{
  return fetch_record(v, block_of(px, v, v->blocks->count.x), block_of(py, v, v->blocks->count.y),
                      block_of(pz, v, v->blocks->count.z));
}

/* Place along one axis among a block's samples. */
typedef struct {
  intN lower;
  floatN fraction;
  intN outside; /* beyond the outermost samples */
} BlockAxis;

/* `place`: in samples, 0 at the first one's centre. `last`: number of the last sample. */
INLINE BlockAxis block_axis(floatN place, intN last)
{
  BlockAxis a;
  const floatN top = TO_FLOAT(last), zero = 0.0f;
  const floatN clamped = lane_clamp(place, zero, top);
  a.outside = MASK(clamped != place);
  a.lower = min(TO_INT(clamped), max(last - 1, (intN)0));
  a.fraction = clamped - TO_FLOAT(a.lower);
  return a;
}

#if SAMPLE_BUFFERS == 1
#define GATHER_SAMPLES(GATHER, offset) GATHER(v->samples[0], offset)
#else
/* Lane by lane from the buffer that has it. */
#define DEFINE_GATHER_SAMPLES(GATHER)                                                              \
  INLINE uintN GATHER##_of_samples(const BlockVolume *v, intN buffer, intN offset)                 \
  {                                                                                                \
    uintN word = 0u;                                                                               \
    for (int k = 0; k < SAMPLE_BUFFERS; ++k) {                                                     \
      const intN here = MASK(buffer == k);                                                         \
      if (any_lane(here)) word |= GATHER(v->samples[k], offset & here) & AS_UINT(here);            \
    }                                                                                              \
    return word;                                                                                   \
  }
DEFINE_GATHER_SAMPLES(gather1)
DEFINE_GATHER_SAMPLES(gather2)
DEFINE_GATHER_SAMPLES(gather4)
#define GATHER_SAMPLES(GATHER, offset) GATHER##_of_samples(v, buffer, offset)
#endif

/* Corners of a cell between samples: `row`, `slice`: samples from one row, one slice to the next; both per lane. */
INLINE FetchedCorners fetch_block_corners(const BlockVolume *v, intN buffer, intN at, intN row, intN slice)
{
  const intN at10 = at + row, at01 = at + slice, at11 = at01 + row;
#if VOXEL_BITS == 8
  const FetchedCorners f = {
    (GATHER_SAMPLES(gather1, at) & 0xffffu) | (GATHER_SAMPLES(gather1, at10) << 16u),
    (GATHER_SAMPLES(gather1, at01) & 0xffffu) | (GATHER_SAMPLES(gather1, at11) << 16u)};
#elif VOXEL_BITS == 16
  const FetchedCorners f = {GATHER_SAMPLES(gather2, at), GATHER_SAMPLES(gather2, at10), GATHER_SAMPLES(gather2, at01),
                            GATHER_SAMPLES(gather2, at11)};
#elif SAMPLE_BUFFERS == 1
  Corners f;
  uintN low, high;
  gather_two4(v->samples[0], at, &low, &high), f.v000 = AS_FLOAT(low), f.v100 = AS_FLOAT(high);
  gather_two4(v->samples[0], at10, &low, &high), f.v010 = AS_FLOAT(low), f.v110 = AS_FLOAT(high);
  gather_two4(v->samples[0], at01, &low, &high), f.v001 = AS_FLOAT(low), f.v101 = AS_FLOAT(high);
  gather_two4(v->samples[0], at11, &low, &high), f.v011 = AS_FLOAT(low), f.v111 = AS_FLOAT(high);
#else
  Corners f;
  f.v000 = AS_FLOAT(GATHER_SAMPLES(gather4, at)), f.v100 = AS_FLOAT(GATHER_SAMPLES(gather4, at + 1));
  f.v010 = AS_FLOAT(GATHER_SAMPLES(gather4, at10)), f.v110 = AS_FLOAT(GATHER_SAMPLES(gather4, at10 + 1));
  f.v001 = AS_FLOAT(GATHER_SAMPLES(gather4, at01)), f.v101 = AS_FLOAT(GATHER_SAMPLES(gather4, at01 + 1));
  f.v011 = AS_FLOAT(GATHER_SAMPLES(gather4, at11)), f.v111 = AS_FLOAT(GATHER_SAMPLES(gather4, at11 + 1));
#endif
  return f;
}

/* A place in one block: where its samples are, and how they are weighted. */
typedef struct {
  intN at, shift;    /* sample of the lower corner, log2 of samples per axis: 0 of a block that has one value */
  floatN value;      /* that value */
  floatN fx, fy, fz; /* place between samples, 0 .. 1 */
  uintN word1;       /* of the block's record */
  intN outside;      /* beyond its outermost samples, along any axis */
} BlockPlace;

INLINE intN has_one_value(uintN word1)
{
  const uintN code = word1 & 15u;
  return MASK(code == 1u) | MASK(code == (uintN)CODE_DROPPED);
}

INLINE BlockPlace place_in_block(const BlockVolume *v, const Record *r, floatN px, floatN py, floatN pz)
{
  const int log_edge = v->blocks->log_edge;
  const float edge = v->blocks->edge;
  const intN code = code_of(r), is_single = has_one_value(r->word1);
  BlockPlace s;
  s.word1 = r->word1;
  const intN shift = (code - 1) & ~is_single, last = ((intN)1 << shift) - 1;
  s.shift = shift;
  const floatN scale = AS_FLOAT((shift + (127 - log_edge)) << 23);
  const BlockAxis x = block_axis((px - edge * TO_FLOAT(r->x)) * scale - 0.5f, last);
  const BlockAxis y = block_axis((py - edge * TO_FLOAT(r->y)) * scale - 0.5f, last);
  const BlockAxis z = block_axis((pz - edge * TO_FLOAT(r->z)) * scale - 0.5f, last);
  s.fx = x.fraction, s.fy = y.fraction, s.fz = z.fraction;
  s.outside = (x.outside | y.outside | z.outside) & ~MASK(code == CODE_DROPPED);
  s.value = AS_FLOAT(r->word0);
  s.at = (AS_INT(r->word0) + ((((z.lower << shift) + y.lower) << shift) + x.lower)) & ~is_single;
  return s;
}

/* Whether all of a packet's blocks are alike: FULL resolution, or some of them have ONE_VALUE. Shifts are the same for
 * all lanes then. */
#define ALIKE_NOT 0
#define ALIKE_FULL 1
#define ALIKE_OR_ONE_VALUE 2

INLINE int alike(const BlockVolume *v, const Record *r)
{
#if SAMPLE_BUFFERS == 1
  const intN other = MASK(code_of(r) != v->blocks->log_edge + 1);
  if (!any_lane(other)) return ALIKE_FULL;
  if (!any_lane(other & ~has_one_value(r->word1))) return ALIKE_OR_ONE_VALUE;
#endif
  return ALIKE_NOT;
}

/* place_in_block() where blocks are alike. `shift` is not set, nor, where all are at full resolution, are `word1` and
 * `value`. */
INLINE BlockPlace place_in_alike_block(const BlockVolume *v, const Record *r, int kind, floatN px, floatN py, floatN pz)
{
  const int log_edge = v->blocks->log_edge;
  const float edge = v->blocks->edge;
  const intN last = (1 << log_edge) - 1;
  BlockPlace s;
  const BlockAxis x = block_axis(px - edge * TO_FLOAT(r->x) - 0.5f, last);
  const BlockAxis y = block_axis(py - edge * TO_FLOAT(r->y) - 0.5f, last);
  const BlockAxis z = block_axis(pz - edge * TO_FLOAT(r->z) - 0.5f, last);
  s.fx = x.fraction, s.fy = y.fraction, s.fz = z.fraction;
  s.outside = x.outside | y.outside | z.outside;
  s.at = AS_INT(r->word0) + ((((z.lower << log_edge) + y.lower) << log_edge) + x.lower);
  if (kind == ALIKE_OR_ONE_VALUE) {
    const intN code = code_of(r);
    /* Around its one sample a block is outside of its hull everywhere. */
    s.outside = (s.outside | MASK(code == 1)) & ~MASK(code == CODE_DROPPED);
    s.at &= ~has_one_value(r->word1);
    s.word1 = r->word1, s.value = AS_FLOAT(r->word0);
  }
  return s;
}

/* The same where `r` is that of another place: rays stay in a block for many steps, and mostly all of a packet do. */
INLINE void move_record(const BlockVolume *v, Record *r, int *kind, floatN px, floatN py, floatN pz)
{
  const intN x = block_of(px, v, v->blocks->count.x), y = block_of(py, v, v->blocks->count.y);
  const intN z = block_of(pz, v, v->blocks->count.z);
  if (any_lane(MASK(((x ^ r->x) | (y ^ r->y) | (z ^ r->z)) != 0))) {
    *r = fetch_record(v, x, y, z);
    *kind = alike(v, r);
  }
}

INLINE floatN mixed_corners(const Corners *c, const BlockPlace *s)
{
  const floatN v00 = mix_corners(c->v000, c->v100, s->fx), v10 = mix_corners(c->v010, c->v110, s->fx);
  const floatN v01 = mix_corners(c->v001, c->v101, s->fx), v11 = mix_corners(c->v011, c->v111, s->fx);
  return mix_corners(mix_corners(v00, v10, s->fy), mix_corners(v01, v11, s->fy), s->fz);
}

INLINE floatN value_in_alike_block(const BlockVolume *v, int kind, const BlockPlace *s)
{
  const int log_edge = v->blocks->log_edge;
  const Corners c = decode_corners(fetch_block_corners(v, (intN)0, s->at, (intN)(1 << log_edge),
                                                       (intN)(1 << 2 * log_edge)), v->view);
  const floatN mixed = mixed_corners(&c, s);
  return kind == ALIKE_FULL ? mixed : select(mixed, s->value, has_one_value(s->word1));
}

INLINE floatN value_in_block(const BlockVolume *v, const BlockPlace *s)
{
  const Corners c = decode_corners(fetch_block_corners(v, AS_INT((s->word1 >> 4u) & 3u), s->at, (intN)1 << s->shift,
                                                       (intN)1 << (2 * s->shift)), v->view);
  return select(mixed_corners(&c, s), s->value, has_one_value(s->word1));
}

#endif
