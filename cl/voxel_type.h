/* Voxel: a voxel in the volume's own type (VOXEL_BITS, VOXEL_SIGNED). */
#ifndef VOXEL_TYPE_H
#define VOXEL_TYPE_H

#if VOXEL_BITS == 8
#if VOXEL_SIGNED
typedef char Voxel;
#else
typedef uchar Voxel;
#endif
#elif VOXEL_BITS == 16
#if VOXEL_SIGNED
typedef short Voxel;
#else
typedef ushort Voxel;
#endif
#elif VOXEL_BITS == 32
typedef float Voxel;
#elif VOXEL_BITS == 64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double Voxel;
#endif

#endif
