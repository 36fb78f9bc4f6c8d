/* Oracles that know the distance beforehand, a byte for each cell of a map (clvol/render/pyramid/maps.py). */
#ifndef ORACLE_MAP_H
#define ORACLE_MAP_H

/* A byte is a float's exponent and the first four bits of its mantissa: 1/16 edge to 2^12 edges. The least one stands for 0. */
INLINE floatN byte_distance(intN byte)
{
  return select(AS_FLOAT((byte + ((127 - 4) << 4)) << 19), (floatN)0.0f, MASK(byte == 0));
}

INLINE floatN map_distance(const Source *in, floatN x, floatN y, floatN z)
{
  const int4 cells = in->pyramid->cells;
  const float4 upper = in->view->upper;
  const floatN zero = 0.0f;
  const intN cx = min(TO_INT(lane_clamp(x, zero, (floatN)upper.x)) >> cells.w, (intN)(cells.x - 1));
  const intN cy = min(TO_INT(lane_clamp(y, zero, (floatN)upper.y)) >> cells.w, (intN)(cells.y - 1));
  const intN cz = min(TO_INT(lane_clamp(z, zero, (floatN)upper.z)) >> cells.w, (intN)(cells.z - 1));
  return byte_distance(AS_INT(gather1(in->map, (cz * cells.y + cy) * cells.x + cx) & 255u));
}

#if ORACLE == ORACLE_MAP
INLINE floatN oracle_distance(const Source *in, floatN x, floatN y, floatN z, floatN value, floatN left)
{
  return map_distance(in, x, y, z);
}
#endif

#endif
