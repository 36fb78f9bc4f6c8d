/* Oracles that know all distances beforehand (clvol/render/pyramid/cells.py). */
INLINE floatN oracle_distance(const Source *in, floatN x, floatN y, floatN z, floatN value, floatN mapped, floatN left)
{
  return mapped;
}
