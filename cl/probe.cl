// One small kernel that uses what the renderer needs of a device: 8-wide vectors of int and float,
// gathers through computed indices, local memory with a barrier, float arithmetic and, where the
// device has it, double. The host (clvol/opencl/probe.py) knows the result of every work-item.

#ifdef CLVOL_PROBE_FP64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double probe_real;
#else
typedef float probe_real;
#endif

__kernel void probe(__global const uchar *voxels, const int voxel_count, const float scale,
                    __global float *sums, __global int *neighbours, __global probe_real *wide,
                    __local int *scratch)
{
    const int i = (int)get_global_id(0);
    const int l = (int)get_local_id(0);
    const int n = (int)get_local_size(0);

    // Eight samples at once, by index, as the ray caster's inner loop takes them.
    const int8 index = (i * 7 + (int8)(0, 1, 2, 3, 4, 5, 6, 7) * 13) % voxel_count;
    const float8 v = (float8)(voxels[index.s0], voxels[index.s1], voxels[index.s2],
                              voxels[index.s3], voxels[index.s4], voxels[index.s5],
                              voxels[index.s6], voxels[index.s7]);
    const float8 inside = select((float8)(0.0f), v * scale, v >= 128.0f);
    const float4 half_sum = inside.lo + inside.hi;
    sums[i] = half_sum.x + half_sum.y + half_sum.z + half_sum.w - 1.0f + exp(-fabs(scale) * 0.0f);

    // The left neighbour of the work-group, through local memory.
    scratch[l] = i;
    barrier(CLK_LOCAL_MEM_FENCE);
    neighbours[i] = scratch[(l + n - 1) % n];

    wide[i] = (probe_real)1 / (probe_real)(i + 1);
}
