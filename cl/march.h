/* What the marches have in common. */
#ifndef MARCH_H
#define MARCH_H

/* Samples between two looks at the map of empty space. Those of blocks fill more vectors the more there are. */
#ifndef MARCH_STEPS
#if BLOCKS && EFFECTS
#define MARCH_STEPS 12
#else
#define MARCH_STEPS 8
#endif
#endif

/* `last` of a ray that needs no more samples, not even of its last piece. */
#define DONE (-2)

#endif
