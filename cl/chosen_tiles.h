/* TILES_CHOSEN: a launch renders the tiles that `chosen` lists, int [items]; other launches, on this device or on others,
 * render the rest. Otherwise items are tiles. */
#ifndef CHOSEN_TILES_H
#define CHOSEN_TILES_H

#if TILES_CHOSEN
#define CHOSEN_PARAMETER , __global const int *restrict chosen
#define TILE_OF(item) chosen[item]
#else
#define CHOSEN_PARAMETER
#define TILE_OF(item) (item)
#endif

#endif
