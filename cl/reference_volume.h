/* The volume as the reference reads it. */
#ifndef REFERENCE_VOLUME_H
#define REFERENCE_VOLUME_H

#ifndef REFERENCE_VOXEL
#error "REFERENCE_VOXEL must name the voxel type"
#endif

typedef struct {
    __global const REFERENCE_VOXEL *voxel; /* [size[2]][size[1]][size[0]] */
    int size[3];
    double scale; /* a power of two that keeps products of huge values finite */
} ReferenceVolume;

static inline double reference_fetch(const ReferenceVolume *volume, int x, int y, int z)
{
    long offset = ((long)z * volume->size[1] + y) * volume->size[0] + x;
    return (double)volume->voxel[offset] * volume->scale;
}

/* Exact at both ends and where a == b. */
static inline double reference_mix(double a, double b, double u)
{
    return u <= 0.5 ? a + u * (b - a) : b - (1.0 - u) * (b - a);
}

#endif
