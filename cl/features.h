/* The vocabulary of what a scene can call for. clvol/features.py holds the same names and numbers; a test compares them. */
#ifndef FEATURES_H
#define FEATURES_H

#define FILTER_NEAREST 0
#define FILTER_LINEAR 1
#define FILTER_CUBIC 2
#define FILTER_CATMULL_ROM 3

#define CLASSIFICATION_PRE 0
#define CLASSIFICATION_POST 1
#define CLASSIFICATION_PREINTEGRATED 2

#define GRADIENT_CENTRAL 1
#define GRADIENT_SOBEL 2
#define GRADIENT_PRECOMPUTED 3
#define GRADIENT_ANALYTIC 4

#define COMPOSITING_OVER 0
#define COMPOSITING_MAXIMUM 1
#define COMPOSITING_MINIMUM 2
#define COMPOSITING_AVERAGE 3
#define COMPOSITING_ATTENUATED_MAXIMUM 4

#define QUADRATURE_STEPS 0
#define QUADRATURE_CELLS 1

#define STEPPING_FULL 0
#define STEPPING_LIMITED 1
#define STEPPING_NAIVE 2
#define STEPPING_BOUNDED 3

#endif
