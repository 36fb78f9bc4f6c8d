/* The exact integral that judges every other method: no step size.
 *
 * One work-item per ray, in double precision. The ray is walked from cell to cell; inside a cell the
 * trilinear field along it is a cubic (reference_field.h), which is split where it crosses control
 * points of the transfer function and integrated to a tolerance (reference_integrate.h). Under the
 * nearest filter the cells are the voxels' own and the field is constant in each; under the cubic
 * filter it is a polynomial of degree 9 in the same cells as the linear one (reference_spline.h).
 *
 * -D REFERENCE_VOXEL=type; -D REFERENCE_NEAREST or REFERENCE_CUBIC; -D REFERENCE_PRECLASSIFIED; and
 * -D REFERENCE_FLOATING where a voxel may be NaN or infinite.
 */
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
/* a * b + c is rounded twice everywhere, so that every machine gives the same picture. */
#pragma OPENCL FP_CONTRACT OFF

#include "reference_rules.h"
#include "reference_transfer.h"
#include "reference_field.h"
#include "reference_integrate.h"

#ifdef REFERENCE_NEAREST
#define REFERENCE_CELL_SHIFT 0.5 /* a voxel's cell reaches half a voxel to either side */
#else
#define REFERENCE_CELL_SHIFT 0.0
#endif

static inline void reference_add_cell(ReferenceRay *ray, const ReferenceTransfer *tf,
                                      const ReferenceVolume *volume, const int index[3],
                                      const double low[3], const double high[3], double t_front,
                                      double length)
{
#ifdef REFERENCE_NEAREST
    double s = reference_fetch(volume, index[0], index[1], index[2]);
    if (isfinite(s))
        reference_add_value(ray, tf, s, t_front, length);
#else
    double tap[REFERENCE_TAPS];
    reference_fetch_taps(volume, index, low, high, tap);
    double smallest = tap[0], largest = tap[0];
    for (int i = 1; i < REFERENCE_TAPS; ++i) {
        smallest = fmin(smallest, tap[i]);
        largest = fmax(largest, tap[i]);
    }
    if (!reference_any_visible(tf, reference_region_above(tf, smallest),
                               reference_region_above(tf, largest)))
        return;
#ifdef REFERENCE_FLOATING
    /* NaN and infinity make transparent exactly the cells that use them. */
    for (int i = 0; i < REFERENCE_TAPS; ++i)
        if (!isfinite(tap[i]))
            return;
#endif
#ifdef REFERENCE_PRECLASSIFIED
    reference_add_classified(ray, tf, tap, low, high, t_front, length);
#else
    ReferenceCurve curve;
    reference_blossom(tap, low, high, curve.bernstein);
    reference_add_curve(ray, tf, &curve, t_front, length);
#endif
#endif
}

/* Rays in index space: position(t) = origin + t direction, t the world distance, t >= 0. */
__kernel void reference_integral(__global const REFERENCE_VOXEL *voxel, int size_x, int size_y,
                                 int size_z, double value_scale,
                                 __global const double *tf_value, __global const double *tf_opacity,
                                 __global const double *tf_clearness,
                                 __global const double *tf_color,
                                 __global const int *tf_visible_below, int tf_count,
                                 double opacity_unit, double tolerance,
                                 __global const double *ray_origin,
                                 __global const double *ray_direction, long ray_count,
                                 __global double *rgba, __global double *depth,
                                 __global double *error, __global uint *counters)
{
    long id = get_global_id(0);
    if (id >= ray_count)
        return;
    ReferenceVolume volume = {voxel, {size_x, size_y, size_z}, value_scale};
    ReferenceTransfer tf = {tf_value, tf_opacity, tf_clearness, tf_color, tf_visible_below,
                            tf_count};
    ReferenceRay ray = {0.0, 1.0, {0.0, 0.0, 0.0}, INFINITY, 0.0, 0.0, 0.0, opacity_unit,
                        0, 0, 0, 0};

    double position[3], direction[3], lower[3], upper[3];
    double t_enter = 0.0, t_leave = INFINITY;
    int missed = 0;
    for (int a = 0; a < 3; ++a) {
        position[a] = ray_origin[3 * id + a];
        direction[a] = ray_direction[3 * id + a];
        lower[a] = volume.size[a] == 1 ? -0.5 : 0.0;
        upper[a] = volume.size[a] == 1 ? 0.5 : volume.size[a] - 1.0;
        if (direction[a] == 0.0) {
            missed |= position[a] < lower[a] || position[a] > upper[a];
        } else {
            double near_plane = direction[a] > 0.0 ? lower[a] : upper[a];
            double far_plane = direction[a] > 0.0 ? upper[a] : lower[a];
            t_enter = fmax(t_enter, (near_plane - position[a]) / direction[a]);
            t_leave = fmin(t_leave, (far_plane - position[a]) / direction[a]);
        }
    }
    uint cells = 0;
    if (!missed && t_enter < t_leave) {
        /* From here on t counts from the entry, so that a far eye costs no digits. */
        int index[3], cell_count[3];
        double t_end = INFINITY;
        for (int a = 0; a < 3; ++a) {
            position[a] = clamp(position[a] + t_enter * direction[a], lower[a], upper[a]);
            if (direction[a] != 0.0)
                t_end = fmin(t_end, ((direction[a] > 0.0 ? upper[a] : lower[a]) - position[a])
                                        / direction[a]);
#ifdef REFERENCE_NEAREST
            cell_count[a] = volume.size[a];
#else
            cell_count[a] = max(volume.size[a] - 1, 1);
#endif
            index[a] = clamp((int)floor(position[a] + REFERENCE_CELL_SHIFT), 0, cell_count[a] - 1);
        }
        ray.error_per_length = tolerance / t_end;
        ray.error_floor = fmax(tolerance / 1024.0, 1e-15);
        double t = 0.0;
        while (t < t_end && ray.transmittance >= ray.error_floor) {
            double next_plane[3], t_next = t_end;
            for (int a = 0; a < 3; ++a) {
                double plane = index[a] + (direction[a] > 0.0 ? 1.0 : 0.0) - REFERENCE_CELL_SHIFT;
                /* An axis with one voxel is one cell: only the domain ends it. */
                next_plane[a] = direction[a] == 0.0 || volume.size[a] == 1
                    ? INFINITY : (plane - position[a]) / direction[a];
                t_next = fmin(t_next, next_plane[a]);
            }
            t_next = fmax(t_next, t);
            if (t_next > t) {
                double low[3], high[3];
                for (int a = 0; a < 3; ++a) {
                    low[a] = clamp(position[a] + t * direction[a] - index[a], 0.0, 1.0);
                    high[a] = clamp(position[a] + t_next * direction[a] - index[a], 0.0, 1.0);
                }
                ++cells;
                reference_add_cell(&ray, &tf, &volume, index, low, high, t_enter + t, t_next - t);
            }
            /* At least one index moves on, or t has reached the end: the walk is finite. */
            int inside = 1;
            for (int a = 0; a < 3; ++a)
                if (next_plane[a] <= t_next) {
                    index[a] += direction[a] > 0.0 ? 1 : -1;
                    inside &= index[a] >= 0 && index[a] < cell_count[a];
                }
            if (!inside)
                break;
            t = t_next;
        }
    }
    for (int k = 0; k < 3; ++k)
        rgba[4 * id + k] = ray.color[k];
    rgba[4 * id + 3] = -expm1(-ray.optical_depth);
    depth[id] = ray.median;
    error[id] = ray.error;
    counters[4 * id] = cells;
    counters[4 * id + 1] = ray.pieces;
    counters[4 * id + 2] = ray.samples;
    counters[4 * id + 3] = ray.failed;
}
