/* The vocabulary that the host and the kernels share: what switches and type codes mean. clvol/features/vocabulary.py
 * has the same names and numbers, and tests/test_features.py compares all of them. Counters (COUNT_...) are in the
 * headers that count: effects.h, block_parameters.h, pyramid.h.
 */
#ifndef FEATURES_H
#define FEATURES_H

/* Switch FILTER: how the volume is reconstructed (sample_volume.h). */
#define FILTER_NEAREST 0
#define FILTER_LINEAR 1
#define FILTER_CUBIC 2
#define FILTER_CATMULL_ROM 3
#define FILTER_MITCHELL 4
#define FILTER_LANCZOS2 5
#define FILTER_LANCZOS3 6
#define FILTER_WINDOWED_SINC 7
#define FILTER_TABLE 8

/* Switch CLASSIFICATION (classify.h). */
#define CLASSIFICATION_PRE 0
#define CLASSIFICATION_POST 1
#define CLASSIFICATION_PREINTEGRATED 2

/* Switch GRADIENT; 0: none is needed (gradient.h). */
#define GRADIENT_CENTRAL 1
#define GRADIENT_SOBEL 2
#define GRADIENT_PRECOMPUTED 3
#define GRADIENT_ANALYTIC 4

/* Switch COMPOSITING (project.h). */
#define COMPOSITING_OVER 0
#define COMPOSITING_MAXIMUM 1
#define COMPOSITING_MINIMUM 2
#define COMPOSITING_AVERAGE 3
#define COMPOSITING_ATTENUATED_MAXIMUM 4

/* Switch QUADRATURE: the plain march, or march_cells.h. */
#define QUADRATURE_STEPS 0
#define QUADRATURE_CELLS 1

/* Switch STEPPING, of a volume of blocks (step_blocks.h). */
#define STEPPING_FULL 0
#define STEPPING_LIMITED 1
#define STEPPING_NAIVE 2
#define STEPPING_BOUNDED 3

/* Switch SLICES; 0: rays take steps of their own (march_slices.h, march_half_angle.h). */
#define SLICES_ALONG_AXIS 1
#define SLICES_ALONG_VIEW 2
#define SLICES_SHELLS 3
#define SLICES_HALF_ANGLE 4

/* Switch ACCUMULATE: what a pixel is rounded to after each slice (march_slices.h). */
#define ACCUMULATE_FLOAT32 0
#define ACCUMULATE_HALF 1
#define ACCUMULATE_UINT8 2

/* Switch ORACLE (oracle.h). */
#define ORACLE_MINIMUM 0
#define ORACLE_MAP 1
#define ORACLE_ERROR 2
#define ORACLE_CUSTOM 3

/* Switch SHADOWS; 0: none (shadow.h). */
#define SHADOWS_RAYS 1
#define SHADOWS_VOLUME 2
#define SHADOWS_HALF_ANGLE 3

/* Switch AMBIENT_OCCLUSION; 0: none (ambient_occlusion.h). */
#define DARKENS_AMBIENT 1
#define DARKENS_ALL 2

/* Bits of the switch OPACITY_FACTORS (opacity_factors.h). */
#define OPACITY_FACTOR_GRADIENT 1
#define OPACITY_FACTOR_DIRECTIONAL 2
#define OPACITY_FACTOR_FUR 4

/* Switch TRANSFER_LAYERS; 0: there is one function of one value (opacity_factors.h, joint_layers.h). */
#define LAYERS_BY_GRADIENT 1
#define LAYERS_OF_TWO 2
#define LAYERS_OF_THREE 3

/* Bits of the switch FIELDS, and roles of fields (fields.h). */
#define FIELD_LABEL 1
#define FIELD_DENSITY 2
#define FIELD_MASK 4
#define FIELD_COLOR 8
#define FIELD_VALUE 16

/* What a term of noise perturbs, and bits of the switch NOISE: whether any term does (noise.h). Attenuation has a switch
 * of its own, TINTED_SCATTERING (light_volume.cl), and fur a bit of OPACITY_FACTORS. */
#define NOISE_TARGET_VALUE 0
#define NOISE_TARGET_COORDINATE 1
#define NOISE_TARGET_ATTENUATION 2
#define NOISE_TARGET_FUR 3
#define NOISE_ADDS (1 << NOISE_TARGET_VALUE)
#define NOISE_MOVES (1 << NOISE_TARGET_COORDINATE)

/* Kinds of lights (shade.h). */
#define LIGHT_DIRECTIONAL 0
#define LIGHT_POINT 1
#define LIGHT_HEADLIGHT 2
#define LIGHT_SPOT 3
#define LIGHT_IMAGE 4

/* Kinds of clips (clip.h). */
#define CLIP_PLANE 0
#define CLIP_BOX 1
#define CLIP_SPHERE 2
#define CLIP_MESH 3

/* How a block's samples arrive (decode_blocks.cl). */
#define CODEC_RAW 0
#define CODEC_CONSTANT 1

/* Codes of blocks in the index (blocks.h): 1 + log2 of the samples per axis, or this. */
#define CODE_DROPPED 15

/* What is in a cell of a volume of blocks (block_cells.cl). */
#define CELL_VISIBLE 0
#define CELL_BESIDE_HOLES 1
#define CELL_EMPTY 255

/* Lengths of arrays in structs. */
#define MOST_FIELDS 8
#define MOST_NOISE_TERMS 4
#define MOST_HALVES 16
#define MOST_LEVELS 5
#define MOST_FILTER_TERMS 9
#define MOST_VOLUME_LEVELS 10

#endif
