/* Grids of light over the volume: linear between the eight points of a cell. */
#ifndef LIGHT_CELLS_H
#define LIGHT_CELLS_H

#include "effects.h"
#include "lanes.h"
#include "sample_volume.h"
#include "vectors.h"
#include "view.h"

/* The lattice points of the points numbered `point`, x first, of a grid of `size` from the volume's first voxel to its
 * last. */
INLINE Vectors grid_place(__constant const View *view, int4 size, intN point)
{
  const intN z = point / (size.x * size.y), y = point / size.x - z * size.y, x = point - (z * size.y + y) * size.x;
  const Vectors place = {TO_FLOAT(x) * (view->upper.x / (float)(size.x - 1)),
                         TO_FLOAT(y) * (view->upper.y / (float)(size.y - 1)),
                         TO_FLOAT(z) * (view->upper.z / (float)(size.z - 1))};
  return place;
}

/* A place in such a grid: its cell's first point, in floats, where it is in the cell, and how far rows and slices are
 * apart. */
typedef struct {
  intN at;
  floatN fx, fy, fz;
  int row, slice;
} LightCell;

/* (x, y, z): lattice; grid: points per lattice unit; size: points; channels: floats per point. */
INLINE LightCell light_cell(floatN px, floatN py, floatN pz, float4 grid, int4 size, int channels)
{
  LightCell c;
  c.row = channels * size.x, c.slice = c.row * size.y;
  const floatN zero = 0.0f;
  const floatN x = lane_clamp(px * grid.x, zero, (floatN)(float)(size.x - 1));
  const floatN y = lane_clamp(py * grid.y, zero, (floatN)(float)(size.y - 1));
  const floatN z = lane_clamp(pz * grid.z, zero, (floatN)(float)(size.z - 1));
  const intN ix = cell_index(x, size.x), iy = cell_index(y, size.y), iz = cell_index(z, size.z);
  c.fx = x - TO_FLOAT(ix), c.fy = y - TO_FLOAT(iy), c.fz = z - TO_FLOAT(iz);
  c.at = channels * ix + c.row * iy + c.slice * iz;
  return c;
}

INLINE floatN light_edge(__global const float *volume, intN at, int channels, floatN f)
{
  const floatN a = AS_FLOAT(gather4(volume, at)), b = AS_FLOAT(gather4(volume + channels, at));
  return a + f * (b - a);
}

/* The channel that `volume` begins with. */
INLINE floatN light_between(__global const float *volume, LightCell c, int channels)
{
  const floatN near_low = light_edge(volume, c.at, channels, c.fx);
  const floatN near_high = light_edge(volume, c.at + c.row, channels, c.fx);
  const floatN far_low = light_edge(volume, c.at + c.slice, channels, c.fx);
  const floatN far_high = light_edge(volume, c.at + c.slice + c.row, channels, c.fx);
  const floatN near = near_low + c.fy * (near_high - near_low), far = far_low + c.fy * (far_high - far_low);
  return near + c.fz * (far - near);
}

/* How far one edge of a light cell goes along `normal`: (x, y, z) is a lattice unit in local space. */
INLINE floatN light_cell_along(Vectors normal, float x, float y, float z, float points)
{
  return fabs(normal.x * x + normal.y * y + normal.z * z) * (1.0f / points);
}

/* The place next to one on a plane surface whose light cell, of a grid of `grid` points per lattice unit, is wholly on
 * the side that the normal (local) points to. */
INLINE Vectors beyond_surface(__constant const Effects *e, Vectors place, Vectors normal, float4 grid)
{
  const floatN across = light_cell_along(normal, e->local_x.x, e->local_y.x, e->local_z.x, grid.x) +
                        light_cell_along(normal, e->local_x.y, e->local_y.y, e->local_z.y, grid.y) +
                        light_cell_along(normal, e->local_x.z, e->local_y.z, e->local_z.z, grid.z);
  return sum3(place, scaled3(direction_to_lattice(e, normal), across));
}

#endif
