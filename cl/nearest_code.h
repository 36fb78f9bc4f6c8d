/* Nearest codewords, four vectors at a time, exactly.
 *
 * A residual r of a stage with the given shift is compared with the codewords as r' = r in quarters of 1 << shift (in
 * 32nds where SIZE is 8), clipped to -511 ... 511 (-4095 ... 4095); codewords e have int8 samples. The nearest one has
 * the largest r' e - 2 e e (r' e - 16 e e). Sums of SIZE such products, in any order and with or without fused
 * multiply-adds, stay below 2^23, and are therefore exact in float: the code does not depend on the device. Of equally
 * near codewords the lowest code is taken.
 *
 * The loop is that of a matrix product: four vectors times 32 codewords are accumulated in eight registers of 16
 * floats. A core with AVX-512 finds three million codes of 64 samples per second with it (PoCL).
 *
 * Switches (-D): SIZE, samples of a sub-block: 8 or 64.
 */
#ifndef NEAREST_CODE_H
#define NEAREST_CODE_H

#define ENTRIES 256
#define FRACTION (SIZE == 8 ? 5 : 2) /* bits of r' below 1 << shift */

/* Writes a residual (int [SIZE]) as r' to `row`. One is subtracted where bits are dropped: of two codewords, the lower
 * one is then nearer to voxels of 8 bits in the middle between them, and decoding rounds down. */
inline void as_compared(__global const int *restrict residual, int shift, float *row)
{
  for (int k = 0; k < SIZE / 8; k++) {
    const int8 r = vload8(k, residual);
    const int8 q = shift > FRACTION ? (r - 1) >> (shift - FRACTION) : r << max(FRACTION - shift, 0);
    vstore8(convert_float8(clamp(q, 1 - (128 << FRACTION), (128 << FRACTION) - 1)), k, row);
  }
}

#define TAKE_LARGEST(key, sums, first) \
  key = max(key, (convert_int16(sums) << 8) | (255 - (lane + (first))))

inline int largest_of(int16 v)
{
  const int8 a = max(v.lo, v.hi);
  const int4 b = max(a.lo, a.hi);
  const int2 c = max(b.lo, b.hi);
  return max(c.lo, c.hi);
}

/* The key of the nearest codeword for each of four vectors, lane by lane of 16: lane l knows the codes l, l + 16, ... The
 * code is 255 - (key & 255), and the nearest of all has the largest key. rows: float [4][SIZE], r' of each vector;
 * codebook float [SIZE][ENTRIES]; norms float [ENTRIES], what is subtracted from r' e, 2^23 of unused ones. */
inline void search_codebook(const float *rows, __global const float *restrict codebook,
                            __global const float *restrict norms, int16 *keys)
{
  const int16 lane = (int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  int16 key0 = (int16)(INT_MIN), key1 = key0, key2 = key0, key3 = key0;
  for (int first = 0; first < ENTRIES; first += 32) {
    const float16 n0 = -vload16(0, norms + first), n1 = -vload16(1, norms + first);
    float16 a0 = n0, a1 = n0, a2 = n0, a3 = n0, b0 = n1, b1 = n1, b2 = n1, b3 = n1;
    __global const float *entry = codebook + first;
    for (int k = 0; k < SIZE; k++, entry += ENTRIES) {
      const float16 e0 = vload16(0, entry), e1 = vload16(1, entry);
      const float x = rows[k], y = rows[SIZE + k], z = rows[2 * SIZE + k], w = rows[3 * SIZE + k];
      a0 = mad(e0, (float16)(x), a0);
      a1 = mad(e0, (float16)(y), a1);
      a2 = mad(e0, (float16)(z), a2);
      a3 = mad(e0, (float16)(w), a3);
      b0 = mad(e1, (float16)(x), b0);
      b1 = mad(e1, (float16)(y), b1);
      b2 = mad(e1, (float16)(z), b2);
      b3 = mad(e1, (float16)(w), b3);
    }
    TAKE_LARGEST(key0, a0, first);
    TAKE_LARGEST(key1, a1, first);
    TAKE_LARGEST(key2, a2, first);
    TAKE_LARGEST(key3, a3, first);
    TAKE_LARGEST(key0, b0, first + 16);
    TAKE_LARGEST(key1, b1, first + 16);
    TAKE_LARGEST(key2, b2, first + 16);
    TAKE_LARGEST(key3, b3, first + 16);
  }
  keys[0] = key0;
  keys[1] = key1;
  keys[2] = key2;
  keys[3] = key3;
}

/* The code of the largest key, which is then left out. */
inline int take_nearest(int16 *keys)
{
  const int key = largest_of(*keys);
  *keys = select(*keys, (int16)(INT_MIN), *keys == (int16)(key));
  return 255 - (key & 255);
}

/* How far the decoded voxels of a sub-block are off: the sum of squares, and the extremes of (original - decoded). In
 * steps of integer types, in working values of floating-point types. */
typedef struct {
  ulong squares;
  int lowest, highest;
} Miss;

/* work: SIZE working values; residual: work minus what is decoded; levels: integers of the volume's range, 65536 for
 * floating-point types. Squares of differences have 32 bits: their halves are summed apart. */
inline Miss measure(__global const ushort *restrict work, __global const int *restrict residual, uint levels)
{
  uint8 low = (uint8)(0), high = (uint8)(0);
  int8 lowest = (int8)(INT_MAX), highest = (int8)(INT_MIN);
  for (int k = 0; k < SIZE / 8; k++) {
    const int8 w = convert_int8(vload8(k, work));
    const uint8 decoded = convert_uint8(clamp(w - vload8(k, residual), 0, 65535));
    const int8 d = convert_int8((convert_uint8(w) * levels) >> 16) - convert_int8((decoded * levels) >> 16);
    const uint8 square = convert_uint8(d * d);
    low += square & 0xffff;
    high += square >> 16;
    lowest = min(lowest, d);
    highest = max(highest, d);
  }
  const uint4 low4 = low.lo + low.hi, high4 = high.lo + high.hi;
  const int4 lowest4 = min(lowest.lo, lowest.hi), highest4 = max(highest.lo, highest.hi);
  const uint2 low2 = low4.lo + low4.hi, high2 = high4.lo + high4.hi;
  const int2 lowest2 = min(lowest4.lo, lowest4.hi), highest2 = max(highest4.lo, highest4.hi);
  const Miss miss = {((ulong)(high2.x + high2.y) << 16) + (low2.x + low2.y), min(lowest2.x, lowest2.y),
                     max(highest2.x, highest2.y)};
  return miss;
}

/* The squared length of a residual less a codeword (char [SIZE]) of a stage; samples count as 65535 at most. */
inline ulong length_without(__global const int *restrict residual, __global const char *restrict entry, int shift)
{
  uint8 low = (uint8)(0), high = (uint8)(0);
  for (int k = 0; k < SIZE / 8; k++) {
    const uint8 d = min(abs(vload8(k, residual) - (convert_int8(vload8(k, entry)) << shift)), (uint8)(65535));
    const uint8 square = d * d;
    low += square & 0xffff;
    high += square >> 16;
  }
  const uint4 low4 = low.lo + low.hi, high4 = high.lo + high.hi;
  const uint2 low2 = low4.lo + low4.hi, high2 = high4.lo + high4.hi;
  return ((ulong)(high2.x + high2.y) << 16) + (low2.x + low2.y);
}

/* Subtracts a codeword (char [SIZE]) of a stage from a residual. */
inline void subtract(__global int *restrict residual, __global const char *restrict entry, int shift)
{
  for (int k = 0; k < SIZE / 8; k++)
    vstore8(vload8(k, residual) - (convert_int8(vload8(k, entry)) << shift), k, residual);
}

#endif
