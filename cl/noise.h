/* Volumetric noise: a tile of 32^3 texels that repeats in space, summed over octaves, perturbs values or places.
 * (Engel and Ertl 2002. clvol/device/noise.py says what the tile holds, fills these structs and has the twin in
 * double.)
 *
 * Each octave doubles the place and takes away whole tiles, both of which are exact in binary: what octaves lose is the
 * rounding of the place itself. Terms move by an offset that the host reduces to one tile.
 */
#ifndef NOISE_H
#define NOISE_H

#include "features.h"
#include "lanes.h"
#include "struct_fields.h"

#define NOISE_TILE 32

typedef struct {
  float4 scale;          /* x, y, z: tiles per lattice unit */
  float4 offset;         /* x, y, z: tiles, 0 .. 1 */
  float4 amplitude;      /* x, y, z: lattice units, of a term that moves places; of fur: root, 1 / (root - tip) */
  float value_amplitude; /* units of the value, of a term that adds to values; what the scene states of others */
  float gain;            /* from octave to octave */
  int octaves;
  int first_texel;       /* of its tile */
} NoiseTerm;

/* Reported to the host (struct_fields.h). */
#define NOISE_TERM_FIELDS  \
  STRUCT(NoiseTerm), FIELD(NoiseTerm, scale), FIELD(NoiseTerm, offset), FIELD(NoiseTerm, amplitude), \
  FIELD(NoiseTerm, value_amplitude), FIELD(NoiseTerm, gain), FIELD(NoiseTerm, octaves), \
  FIELD(NoiseTerm, first_texel)

/* The eight texels around a place, x changing fastest, and the place between them. */
typedef struct {
  uintN corner[8];
  floatN fx, fy, fz;
} NoiseTexels;

/* x without whole tiles: exact, 0 .. 1 (1 itself only where x is just below a whole number). */
INLINE floatN within_tile(floatN x) { return x - floor(x); }

INLINE NoiseTexels fetch_noise(__global const uint *tile, floatN x, floatN y, floatN z)
{
  NoiseTexels t;
  x *= (float)NOISE_TILE, y *= (float)NOISE_TILE, z *= (float)NOISE_TILE;
  const floatN wx = floor(x), wy = floor(y), wz = floor(z);
  t.fx = x - wx, t.fy = y - wy, t.fz = z - wz;
  const intN last = NOISE_TILE - 1;
  const intN ix = TO_INT(wx), iy = TO_INT(wy), iz = TO_INT(wz);
  const intN x0 = ix & last, x1 = (ix + 1) & last;
  const intN y0 = (iy & last) * NOISE_TILE, y1 = ((iy + 1) & last) * NOISE_TILE;
  const intN z0 = (iz & last) * (NOISE_TILE * NOISE_TILE), z1 = ((iz + 1) & last) * (NOISE_TILE * NOISE_TILE);
  t.corner[0] = gather4(tile, z0 + y0 + x0), t.corner[1] = gather4(tile, z0 + y0 + x1);
  t.corner[2] = gather4(tile, z0 + y1 + x0), t.corner[3] = gather4(tile, z0 + y1 + x1);
  t.corner[4] = gather4(tile, z1 + y0 + x0), t.corner[5] = gather4(tile, z1 + y0 + x1);
  t.corner[6] = gather4(tile, z1 + y1 + x0), t.corner[7] = gather4(tile, z1 + y1 + x1);
  return t;
}

/* The noise of one channel there, -1 .. 1. */
INLINE floatN noise_channel(const NoiseTexels *t, int channel)
{
  floatN v[8];
  for (int k = 0; k < 8; ++k) v[k] = TO_FLOAT((t->corner[k] >> (uint)(8 * channel)) & 255u);
  const floatN v00 = v[0] + t->fx * (v[1] - v[0]), v10 = v[2] + t->fx * (v[3] - v[2]);
  const floatN v01 = v[4] + t->fx * (v[5] - v[4]), v11 = v[6] + t->fx * (v[7] - v[6]);
  const floatN v0 = v00 + t->fy * (v10 - v00), v1 = v01 + t->fy * (v11 - v01);
  return (v0 + t->fz * (v1 - v0)) * (2.0f / 255.0f) - 1.0f;
}

/* The sum over octaves at (x, y, z) in tiles: one channel of it, ... */
INLINE floatN fractal_noise_value(__global const uint *tiles, __constant const NoiseTerm *term, floatN x, floatN y,
                                  floatN z)
{
  floatN sum = 0.0f;
  float weight = 1.0f;
  x = within_tile(x), y = within_tile(y), z = within_tile(z);
  _Pragma("unroll 1") for (int octave = 0; octave < term->octaves; ++octave) {
    const NoiseTexels t = fetch_noise(tiles + term->first_texel, x + term->offset.x, y + term->offset.y,
                                      z + term->offset.z);
    sum += weight * noise_channel(&t, 3);
    weight *= term->gain;
    x = within_tile(x + x), y = within_tile(y + y), z = within_tile(z + z);
  }
  return sum;
}

/* ... or three. */
INLINE void fractal_noise(__global const uint *tiles, __constant const NoiseTerm *term, floatN x, floatN y, floatN z,
                          floatN *sum_x, floatN *sum_y, floatN *sum_z)
{
  floatN sx = 0.0f, sy = 0.0f, sz = 0.0f;
  float weight = 1.0f;
  x = within_tile(x), y = within_tile(y), z = within_tile(z);
  _Pragma("unroll 1") for (int octave = 0; octave < term->octaves; ++octave) {
    const NoiseTexels t = fetch_noise(tiles + term->first_texel, x + term->offset.x, y + term->offset.y,
                                      z + term->offset.z);
    sx += weight * noise_channel(&t, 0), sy += weight * noise_channel(&t, 1), sz += weight * noise_channel(&t, 2);
    weight *= term->gain;
    x = within_tile(x + x), y = within_tile(y + y), z = within_tile(z + z);
  }
  *sum_x = sx, *sum_y = sy, *sum_z = sz;
}

/* What terms[0 .. count - 1], all NOISE_TARGET_VALUE, add to the value at a lattice place. */
INLINE floatN added_noise(__global const uint *tiles, __constant const NoiseTerm *terms, int count, floatN x,
                          floatN y, floatN z)
{
  floatN sum = 0.0f;
  _Pragma("unroll 1") for (int k = 0; k < count; ++k) {
    __constant const NoiseTerm *term = terms + k;
    sum += term->value_amplitude *
           fractal_noise_value(tiles, term, x * term->scale.x, y * term->scale.y, z * term->scale.z);
  }
  return sum;
}

/* Moves a lattice place by terms[0 .. count - 1], all NOISE_TARGET_COORDINATE and all taken where it was at first. */
INLINE void displace(__global const uint *tiles, __constant const NoiseTerm *terms, int count, floatN *x, floatN *y,
                     floatN *z)
{
  const floatN x0 = *x, y0 = *y, z0 = *z;
  _Pragma("unroll 1") for (int k = 0; k < count; ++k) {
    __constant const NoiseTerm *term = terms + k;
    floatN sx, sy, sz;
    fractal_noise(tiles, term, x0 * term->scale.x, y0 * term->scale.y, z0 * term->scale.z, &sx, &sy, &sz);
    *x += term->amplitude.x * sx, *y += term->amplitude.y * sy, *z += term->amplitude.z * sz;
  }
}

#endif
