/* What the marches have in common. */
#ifndef MARCH_H
#define MARCH_H

/* Samples between two looks at the map of empty space. */
#ifndef MARCH_STEPS
#define MARCH_STEPS 8
#endif

/* `last` of a ray that needs no more samples, not even of its last piece. */
#define DONE (-2)

#endif
