/* How maps of distances lie in memory (clvol/integrators/pyramid/cells.py). */
#ifndef ORACLE_LAYOUT_H
#define ORACLE_LAYOUT_H

/* Where a map has the byte of cell (i, j, k) along x, y, z: cubes of 4 by 4 by 4 cells after each other, one to a
 * cache line, since neighbouring rays look at neighbouring cells. */
#define MAP_AT(cells, i, j, k) \
  (((((k) >> 2) * (((cells).y + 3) >> 2) + ((j) >> 2)) * (((cells).x + 3) >> 2) + ((i) >> 2)) << 6 | ((k)&3) << 4 | \
   ((j)&3) << 2 | ((i)&3))

#endif
